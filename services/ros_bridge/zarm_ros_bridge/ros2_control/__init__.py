"""The robot and its grippers as controllers of ros2_control."""
