"""Zenoh sessions as zarm opens them: clients of a router, without multicast discovery."""

from __future__ import annotations

import json
import logging
import os
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import zenoh

from zarm_contract.access import access_control
from zarm_contract.codec import MAX_BYTES
from zarm_contract.errors import InvalidRequest, Unavailable
from zarm_contract.roles import Role
from zarm_runtime.realtime import PROCESS_PRIORITY, realtime_offspring
from zarm_runtime.security import client_role, security_on

if TYPE_CHECKING:
    from zarm_runtime.certificates import Certificates

log = logging.getLogger(__name__)

DEFAULT_ENDPOINT = "tcp/127.0.0.1:7447"
"""Default endpoint of routers and clients: loopback, Zenoh's usual port."""

ROUTER_MAX_BYTES = 2 * MAX_BYTES
"""Longest payload that a router passes on. One that is only slightly too long is refused by its receiver, with a
message.
"""

_ROUTER_RUNTIME = "(rx: (worker_threads: 16))"
"""Each client that publishes to a blocked one occupies one of these threads until the blocked link is given up. Zenoh's
default of two is soon exhausted, and then nothing passes, not even a stop.
"""

_ENDPOINT = re.compile(r"(?:(?:tcp|tls|quic|ws|udp)/\S+:\d+|unixsock-stream/\S+?)(?:[?#]\S*)?")
_LOCAL = re.compile(r"\w+/(?:127\.|localhost:|\[::1\])|unixsock-stream/")


def open_client(endpoint: str = DEFAULT_ENDPOINT, timeout: float = 5.0, role: Role | None = None) -> zenoh.Session:
    """A session that is a client of the router at `endpoint`; waits `timeout` s for it.

    `role` is its role with ZARM_SECURITY on (default: ZARM_ROLE). Once open it reconnects by itself when the router
    returns. Raises InvalidRequest for an invalid endpoint or certificates, and Unavailable.
    """
    certificates = _certificates(role or client_role()) if security_on() else None
    place = resolved_endpoint(endpoint)
    try:
        return zenoh.open(_config(_client_settings(place, timeout) | (certificates.settings() if certificates else {})))
    except zenoh.ZError as error:
        reason = certificates.why_not(*_address(place)) if certificates else None
        raise Unavailable(f"no session with {place}: {reason}" if reason else _why_not(place)) from error


def resolved_endpoint(endpoint: str) -> str:
    """The endpoint to use: with ZARM_SECURITY on, `tcp/...` becomes `tls/...`. Raises InvalidRequest for an invalid
    one.
    """
    if not _ENDPOINT.fullmatch(endpoint):
        raise InvalidRequest(f"{endpoint!r} is not an endpoint; write it like {DEFAULT_ENDPOINT}")
    protocol, _, address = endpoint.partition("/")
    if not security_on():
        if protocol in ("tls", "quic"):
            raise InvalidRequest(f"{endpoint} needs certificates; set ZARM_SECURITY=on and ZARM_CERTS")
        return endpoint
    if protocol not in ("tcp", "tls"):
        raise InvalidRequest(f"with ZARM_SECURITY=on an endpoint begins with tls/, and {endpoint} does not")
    return f"tls/{address}"


def open_router(endpoint: str) -> zenoh.Session:
    """A router in this process that listens at `endpoint`. Raises what `router_config` and `run_router` raise."""
    return run_router(router_config(endpoint))


def router_config(listen: str | None = None, links: Sequence[str] = (), *, config: Path | None = None) -> zenoh.Config:
    """A router that listens at `listen`, linked to the routers at the endpoints `links`, each link retried for ever.

    `config` is a file in Zenoh's own format whose settings replace zarm's; `listen` and `links`, if given, override it.
    Without any address the default endpoint is used. With ZARM_SECURITY on, certificates and access control are added
    whatever the file says. Raises InvalidRequest for an invalid file, endpoint or certificates.
    """
    settings = _config(_ROUTER) if config is None else _read(config)
    changes: dict[str, object] = {"mode": "router"}
    unsaid = settings.get_json("listen/endpoints") == zenoh.Config().get_json("listen/endpoints")
    if listen is not None or unsaid:  # Zenoh itself would listen everywhere
        changes["listen/endpoints"] = [resolved_endpoint(listen or DEFAULT_ENDPOINT)]
    if links:
        changes["connect/endpoints"] = [resolved_endpoint(link) for link in links]
    _set(settings, changes)
    if security_on():
        said = {name: [resolved_endpoint(one) for one in _endpoints(settings, name)] for name in ("listen", "connect")}
        _set(settings, {f"{name}/endpoints": endpoints for name, endpoints in said.items()})
        _set(settings, _certificates("router").settings() | {"access_control": access_control()})
    return settings


def run_router(config: zenoh.Config) -> zenoh.Session:
    """A router in this process, with a configuration from `router_config`. Raises Unavailable if it cannot listen.

    Its threads have a real-time priority if allowed, because every command to a robot passes through them. If everyone
    on the network may use it, a warning says so.
    """
    if exposed := _open_to_all(config):
        log.warning(
            "WARNING: anyone who reaches %s from another machine can move the robot, because no certificate is required; "
            "run `zarm certs FOLDER` and set ZARM_SECURITY=on and ZARM_CERTS=FOLDER, or listen on loopback",
            " and ".join(exposed),
        )
    os.environ.setdefault("ZENOH_RUNTIME", _ROUTER_RUNTIME)  # Zenoh reads it when a process opens its first session
    try:
        with realtime_offspring(PROCESS_PRIORITY):
            return zenoh.open(config)
    except zenoh.ZError as error:
        raise Unavailable(
            f"cannot listen at {' and '.join(listens_at(config))}: the port is taken or not allowed; use --listen with "
            "another, or --connect to join the router that is there"
        ) from error


def listens_at(config: zenoh.Config) -> list[str]:
    """The endpoints at which a router of this configuration listens."""
    return _endpoints(config, "listen")


def _open_to_all(config: zenoh.Config) -> list[str]:
    if json.loads(config.get_json("access_control/enabled")):
        return []
    return [endpoint for endpoint in listens_at(config) if not _LOCAL.match(endpoint)]


_ALONE: dict[str, object] = {
    "scouting/multicast/enabled": False,
    "scouting/gossip/enabled": False,
    # A killed process would leave its shared memory, 16 MB, behind, and a full /dev/shm kills those still running.
    "transport/shared_memory/enabled": False,
    "scouting/delay": 0,  # a router would wait half a second for peers that it does not search
    # Zenoh's own, from 1 s to 4 s, leaves a robot without its driver long after a cable is reconnected.
    "connect/retry": {"period_init_ms": 100, "period_max_ms": 500, "period_increase_factor": 2},
}


_ROUTER = _ALONE | {
    "connect/timeout_ms": -1,
    "connect/exit_on_failure": False,
    # A silent link is given up after 5 s and reopened: TCP alone, or Zenoh's own 10 s, leaves it silent for as long
    # again as it was cut. Not sooner: an executor that hears nothing brakes and then empties its driver, within 4 s,
    # and of what a silent link holds up the driver must get the last, not the braking alone.
    "transport/link/tx/lease": 5000,
    "transport/unicast/open_timeout": 2000,
    "transport/link/tx/queue/congestion_control/block/wait_before_close": 1_000_000,
    "low_pass_filter": [
        {
            "id": "no message of zarm is half as long",
            "flows": ["ingress"],
            "messages": ["put", "delete", "query", "reply"],
            "key_exprs": ["**"],
            "size_limit": ROUTER_MAX_BYTES,
        }
    ],
    # A message is assembled before it is measured; this bounds the memory for that.
    "transport/link/rx/max_message_size": 2 * ROUTER_MAX_BYTES,
}
"""The same settings as in deploy/router.json5."""


def _client_settings(endpoint: str, timeout: float) -> dict[str, object]:
    return _ALONE | {
        "mode": "client",
        "listen/endpoints": [],
        "connect/endpoints": [endpoint],
        "connect/timeout_ms": int(timeout * 1000),
        "connect/exit_on_failure": True,
    }


def _endpoints(config: zenoh.Config, name: str) -> list[str]:
    said = json.loads(config.get_json(f"{name}/endpoints"))
    found: list[str] = said.get("router", []) if isinstance(said, dict) else said
    return found


def _address(endpoint: str) -> tuple[str, int]:
    host, _, port = re.split(r"[?#]", endpoint.partition("/")[2])[0].rpartition(":")
    return host.strip("[]"), int(port)


def _certificates(role: Role) -> Certificates:
    from zarm_runtime.certificates import Certificates

    return Certificates(role)


def _why_not(place: str) -> str:
    """Why there is no session with a router at this endpoint."""
    from zarm_runtime.probe import what_listens  # needed only here

    listener = what_listens(*_address(place)) if place.startswith(("tcp/", "tls/")) else "nobody"
    if listener == "silent":
        return (
            f"what listens at {place} takes connections and does not answer: it hangs, is kept busy, or is no Zenoh router; see "
            "which process has that port"
        )
    if listener == "tls" and not security_on():
        return f"what listens at {place} speaks TLS; set ZARM_SECURITY=on and ZARM_CERTS here too"
    if listener != "nobody":
        return f"what listens at {place} opened no session in time: it is busy, or is no Zenoh router"
    return (
        f"no Zenoh router answers at {place}; start one with `zarm up`, or name another with --connect or ZARM_CONNECT"
    )


def _read(file: Path) -> zenoh.Config:
    try:
        return zenoh.Config.from_file(str(file))
    except zenoh.ZError as error:
        reason = str(error).rpartition(" at /")[0]  # without the place in Zenoh's source
        raise InvalidRequest(
            f"{file} is not a configuration of Zenoh that can be read ({reason}); deploy/router.json5 is one",
            field="--config",
        ) from error


def _config(settings: Mapping[str, object]) -> zenoh.Config:
    config = zenoh.Config()
    _set(config, settings)
    return config


def _set(config: zenoh.Config, settings: Mapping[str, object]) -> None:
    for path, value in settings.items():
        config.insert_json5(path, json.dumps(value))
