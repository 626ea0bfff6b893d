"""Times and durations."""

from __future__ import annotations

from builtin_interfaces.msg import Duration, Time

NANOSECONDS = 10**9
"""In a second."""


def ros_time(stamp: float) -> Time:
    """Unix seconds as the time of ROS, to the nanosecond that a double can tell."""
    seconds, rest = divmod(round(stamp * NANOSECONDS), NANOSECONDS)
    return Time(sec=seconds, nanosec=rest)


def ros_duration(seconds: float) -> Duration:
    """Seconds as a duration of ROS, to the nanosecond."""
    whole, rest = divmod(round(seconds * NANOSECONDS), NANOSECONDS)
    return Duration(sec=whole, nanosec=rest)
