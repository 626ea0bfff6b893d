"""Tests that need ROS: left out where it is not installed; each session in a DDS domain of its own."""

from __future__ import annotations

from importlib.util import find_spec

from ros_domain import isolate

MISSING = [package for package in ("rclpy", "curobo_msgs") if find_spec(package) is None]
collect_ignore_glob = ["*"] if MISSING else []

isolate()
