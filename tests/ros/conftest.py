"""Tests that need ROS: skipped, with the reason, where it is not installed; each session in a DDS domain of its own."""

from __future__ import annotations

import os
import socket
from importlib.util import find_spec
from pathlib import Path

HERE = Path(__file__).parent
MISSING = [package for package in ("rclpy", "curobo_msgs") if find_spec(package) is None]
collect_ignore_glob = ["*"] if MISSING else []


def _free_domain() -> int:
    """A DDS domain in which nobody is: the port of its first participant is free (7400 + 250 d + 10, DDSI-RTPS 9.6.1)."""
    for domain in range(1, 100):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            try:
                probe.bind(("127.0.0.1", 7400 + 250 * domain + 10))
            except OSError:
                continue
            return domain
    raise RuntimeError("every DDS domain is taken")


os.environ["ROS_DOMAIN_ID"] = str(_free_domain())
os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
