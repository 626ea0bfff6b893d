"""How a zarm process joins ROS 2: Fast DDS settings in the environment."""

from __future__ import annotations

import logging
import os
from pathlib import Path

log = logging.getLogger(__name__)

RANGE = "ROS_AUTOMATIC_DISCOVERY_RANGE"
_LOCALHOST_ONLY = "ROS_LOCALHOST_ONLY"  # the variable before Jazzy
_PEERS = ("ROS_STATIC_PEERS", "ROS_DISCOVERY_SERVER")
_PROFILES = ("FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE")
REACH = (RANGE, _LOCALHOST_ONLY, *_PEERS, *_PROFILES)
"""If any of these is set, the user has decided whom DDS is to reach."""
NETWORK, LOCALHOST = (str(Path(__file__).with_name(f"dds_{reach}.xml")) for reach in ("network", "localhost"))


def join() -> None:
    """Set what Fast DDS reads when the first participant of this process is created; existing variables take
    precedence.

    Shared memory with other processes is disabled: what a killed process has left there holds up anyone who opens it
    next for a third of a second, such as a driver sending to a bridge, or a bridge answering a client. ROS itself uses
    shared memory when it is limited to this machine, so that limit is set by a profile, `LOCALHOST`. If DDS listens on
    other interfaces, the log warns.
    """
    said = {name for name in REACH if os.environ.get(name)}
    if not os.environ.get("RMW_IMPLEMENTATION", "rmw_fastrtps").startswith("rmw_fastrtps") or said & {*_PROFILES}:
        return
    os.environ.setdefault("FASTDDS_BUILTIN_TRANSPORTS", "UDPv4")
    reach = "LOCALHOST" if os.environ.get(_LOCALHOST_ONLY) == "1" else os.environ.get(RANGE, "SUBNET")
    if reach == "LOCALHOST" and not said & {*_PEERS}:
        os.environ |= {RANGE: "SYSTEM_DEFAULT", _LOCALHOST_ONLY: "", _PROFILES[0]: LOCALHOST}
        log.info("DDS is limited to this machine others=%s", f"{RANGE}=SUBNET")
        return
    os.environ[_PROFILES[0]] = NETWORK
    if reach not in ("LOCALHOST", "OFF"):
        log.warning(
            "DDS listens on every interface, and whoever reaches it can move the robot remedy=%s", f"{RANGE}=LOCALHOST"
        )
