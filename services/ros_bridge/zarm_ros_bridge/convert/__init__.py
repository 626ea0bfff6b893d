"""Conversions between messages of zarm and of ROS.

Input from ROS is validated here, and refused by an InvalidRequest that names the ROS field. Units are the same on both
sides (m, rad, s), and so is the order of a quaternion: x, y, z, w.
"""
