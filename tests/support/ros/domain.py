"""A DDS domain of one's own: tests and benchmarks on ROS hear nobody else, and nothing leaves this machine."""

from __future__ import annotations

import os
import socket

from zarm_runtime.dds import LOCALHOST

_mine: list[socket.socket] = []  # holds the domain until this process ends


def isolate() -> None:
    """Take a domain in which nobody is, for this process and those that it starts. Before the first `rclpy.init`.

    Without the shared memory of Fast DDS, which ROS itself would use on the loopback: what a process that is killed leaves there
    holds up whoever opens it next for a third of a second.
    """
    os.environ["ROS_DOMAIN_ID"] = str(_free_domain())
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "SYSTEM_DEFAULT"  # what the file says
    os.environ["FASTRTPS_DEFAULT_PROFILES_FILE"] = LOCALHOST


def _free_domain() -> int:
    """One that no participant is in, and that no other process has taken for the one that it will start.

    The port of its first participant is free: 7400 + 250 d + 10 (DDSI-RTPS 2.5, 9.6.2). An abstract socket is the mark of who
    has taken it, and goes with its process. Where to begin differs from process to process, for those that leave no mark.
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
