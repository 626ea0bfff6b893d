"""Joints for poses of the tip, and poses for joints."""
