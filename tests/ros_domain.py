"""A DDS domain of one's own: tests and benchmarks on ROS hear nobody else, and nothing leaves this machine."""

from __future__ import annotations

import os
import socket


def isolate() -> None:
    """Take a domain in which nobody is, for this process and those that it starts. Before the first `rclpy.init`."""
    os.environ["ROS_DOMAIN_ID"] = str(_free_domain())
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"


def _free_domain() -> int:
    """The port of its first participant is free: 7400 + 250 d + 10 (DDSI-RTPS 2.5, 9.6.2)."""
    for domain in range(1, 100):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            try:
                probe.bind(("", 7400 + 250 * domain + 10))
            except OSError:
                continue
            return domain
    raise RuntimeError("every DDS domain is taken")
