"""A robot descriptor from any URDF or xacro, and what is wrong with one."""
