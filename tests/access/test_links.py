"""Linked routers with certificates are one bus, on which a role has the same rights from wherever it connects."""

from __future__ import annotations

import json
from pathlib import Path

import zenoh

from support.command_line import Router
from support.harness import eventually, free_endpoint
from zarm_contract.errors import Unavailable
from zarm_contract.keys import Keys
from zarm_contract.messages import ExecutorState, Nothing
from zarm_runtime.bus import Bus
from zarm_runtime.session import open_client

KEYS = Keys("some_robot")
IDLE = ExecutorState(mode="idle", strategy="emulator", speed_scale=1.0, missed_ticks=0)


def test_rights_hold_across_linked_routers(secured: Path, tmp_path: Path) -> None:
    settings = {"ZARM_SECURITY": "on", "ZARM_CERTS": str(secured)}
    near, far = free_endpoint(), free_endpoint()
    with (
        Router(tmp_path, "--listen", far, "--link", near, **settings),
        Router(tmp_path, "--listen", near, **settings),
        Bus(far, role="executor") as executor,
        Bus(near, role="operator") as operator,
        open_client(near, role="viewer") as viewer,
    ):
        executor.serve(KEYS.pause, lambda _: IDLE)
        executor.declare_alive(KEYS.alive("executor", "one"))

        def paused() -> bool:
            try:
                operator.call(KEYS.pause, Nothing(), timeout=1)
            except Unavailable:
                return False
            return True

        eventually(paused, "the operator is answered from the other router")
        assert not list(viewer.get(KEYS.pause, timeout=5))
        eventually(lambda: operator.alive(KEYS.alive("*", "*")), "the executor is seen from the other router")


def test_with_a_viewer_certificate_a_router_makes_all_viewers(secured: Path, tmp_path: Path) -> None:
    near = free_endpoint()
    tls = {
        "root_ca_certificate": str(secured / "ca.pem"),
        "connect_certificate": str(secured / "viewer.pem"),
        "connect_private_key": str(secured / "viewer.key"),
        "enable_mtls": True,
    }
    with (
        Router(tmp_path, "--listen", near, ZARM_SECURITY="on", ZARM_CERTS=str(secured)),
        Bus(near, role="executor") as executor,
        zenoh.open(config("router", near, tls=tls, listen=(behind := free_endpoint()))),
        zenoh.open(config("client", behind)) as client,
    ):
        for key in (KEYS.pause, KEYS.stop):
            executor.serve(key, lambda _: IDLE)
        eventually(lambda: answered(client, KEYS.stop), "the robot is stopped through it")
        assert not answered(client, KEYS.pause)


def answered(client: zenoh.Session, key: str) -> bool:
    return any(one.ok for one in client.get(key, timeout=2))


def config(mode: str, connect: str, *, listen: str | None = None, tls: dict[str, object] | None = None) -> zenoh.Config:
    settings = {
        "mode": mode,
        "listen/endpoints": [listen] if listen else [],
        "connect/endpoints": [connect.replace("tcp/", "tls/") if tls else connect],
        "scouting/multicast/enabled": False,
    } | {f"transport/link/tls/{name}": value for name, value in (tls or {}).items()}
    made = zenoh.Config()
    for name, value in settings.items():
        made.insert_json5(name, json.dumps(value))
    return made
