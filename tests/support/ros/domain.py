"""A private DDS domain: tests and benchmarks on ROS hear nobody else, and nothing leaves this machine."""

from __future__ import annotations

import os
import socket

from zarm_runtime.dds import LOCALHOST

_mine: list[socket.socket] = []  # holds the domain until this process ends


def isolate() -> None:
    """Take an unused domain for this process and those that it starts. Call before the first `rclpy.init`.

    Without the shared memory of Fast DDS, which ROS itself would use on the loopback: what a killed process leaves
    there holds up anyone who opens it next for a third of a second.
    """
    os.environ["ROS_DOMAIN_ID"] = str(_free_domain())
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "SYSTEM_DEFAULT"  # what the file says
    os.environ["FASTRTPS_DEFAULT_PROFILES_FILE"] = LOCALHOST


def _free_domain() -> int:
    """A domain without participants that no other process has reserved.

    The port of its first participant is free: 7400 + 250 d + 10 (DDSI-RTPS 2.5, 9.6.2). An abstract socket marks the
    reservation, and disappears with its process. The search starts at a different domain in each process, because of
    those that leave no mark.
    """
    first = os.getpid() % 100
    for domain in (1 + (first + step) % 100 for step in range(100)):
        mark = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            try:
                mark.bind(f"\0zarm_ros_domain_{domain}")
                probe.bind(("", 7400 + 250 * domain + 10))
            except OSError:
                mark.close()
                continue
        _mine.append(mark)
        return domain
    raise RuntimeError("every DDS domain is taken")
