"""Makes a robot descriptor from any URDF or xacro, and checks one."""
