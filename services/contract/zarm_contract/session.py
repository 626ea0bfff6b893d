"""Zenoh sessions as zarm opens them: clients of a router, nothing found by multicast."""

from __future__ import annotations

import json
import re

import zenoh

from zarm_contract.errors import InvalidRequest, Unavailable
from zarm_contract.realtime import PROCESS_PRIORITY, realtime_offspring

DEFAULT_ENDPOINT = "tcp/127.0.0.1:7447"
"""Where a router listens and clients look unless told otherwise: loopback, Zenoh's usual port."""

_ENDPOINT = re.compile(r"(?:(?:tcp|tls|quic|ws|udp)/\S+:\d+|unixsock-stream/\S+?)(?:[?#]\S*)?")


def open_client(endpoint: str = DEFAULT_ENDPOINT, timeout: float = 5.0) -> zenoh.Session:
    """A session that is a client of the router at `endpoint`; waits `timeout` s for it. Raises Unavailable.

    Once open it reconnects by itself when the router comes back.
    """
    config = _config("client", connect=endpoint, timeout=timeout)
    try:
        return zenoh.open(config)
    except zenoh.ZError as error:
        raise Unavailable(
            f"no Zenoh router answers at {endpoint}; start one with `zarm up`, or name another with --connect or ZARM_CONNECT"
        ) from error


def open_router(endpoint: str, connect: str | None = None) -> zenoh.Session:
    """A router in this process that listens at `endpoint` and, if given, links to the router at `connect`.

    Its threads have a real-time priority where that is allowed, as every command to a robot passes through them. Raises
    Unavailable where the endpoint is taken.
    """
    config = _config("router", listen=endpoint, connect=connect)
    try:
        with realtime_offspring(PROCESS_PRIORITY):
            return zenoh.open(config)
    except zenoh.ZError as error:
        raise Unavailable(
            f"cannot listen at {endpoint}: the port is taken or not allowed; use --listen with another, or --connect to "
            "join the router that is there"
        ) from error


def _config(
    mode: str, *, listen: str | None = None, connect: str | None = None, timeout: float | None = None
) -> zenoh.Config:
    for endpoint in (listen, connect):
        if endpoint is not None and not _ENDPOINT.fullmatch(endpoint):
            raise InvalidRequest(f"{endpoint!r} is no endpoint; write it like {DEFAULT_ENDPOINT}")
    settings: dict[str, object] = {
        "mode": mode,
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        # A killed process would leave its shared memory, 16 MB, behind, and a full /dev/shm ends those who live on.
        "transport/shared_memory/enabled": False,
        "scouting/delay": 0,  # a router would wait half a second for whom it does not look for
        "listen/endpoints": [listen] if listen else [],
        "connect/endpoints": [connect] if connect else [],
    }
    if timeout is not None:
        settings |= {"connect/timeout_ms": int(timeout * 1000), "connect/exit_on_failure": True}
        # Zenoh's own, from 1 s to 4 s, leaves a robot without its driver for long after a cable is back.
        settings["connect/retry"] = {"period_init_ms": 100, "period_max_ms": 500, "period_increase_factor": 2}
    config = zenoh.Config()
    for path, value in settings.items():
        config.insert_json5(path, json.dumps(value))
    return config
