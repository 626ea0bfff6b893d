"""Conversions between messages of zarm and of ROS.

What comes from ROS is checked here, and refused by an InvalidRequest that names the field as ROS knows it. Units are the same
on both sides (m, rad, s), and so is the order of a quaternion: x, y, z, w.
"""
