"""Times and durations."""

from __future__ import annotations

from builtin_interfaces.msg import Duration, Time

NANOSECONDS = 10**9
"""Nanoseconds in a second."""


def ros_time(stamp: float) -> Time:
    """Unix seconds as ROS time, to the nanosecond as far as a double resolves it."""
    seconds, rest = divmod(round(stamp * NANOSECONDS), NANOSECONDS)
    return Time(sec=seconds, nanosec=rest)


def ros_duration(seconds: float) -> Duration:
    """Seconds as a ROS duration, to the nanosecond."""
    whole, rest = divmod(round(seconds * NANOSECONDS), NANOSECONDS)
    return Duration(sec=whole, nanosec=rest)
