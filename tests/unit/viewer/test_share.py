"""viser's share, a tunnel from its makers' server to this one, is off."""

from __future__ import annotations

import msgspec
import pytest
import viser
from websockets.sync.client import connect
from websockets.typing import Subprotocol

from support.harness import eventually
from zarm_viewer.gate import Gate


def test_a_page_that_asks_for_a_tunnel_past_the_gate_gets_none(monkeypatch: pytest.MonkeyPatch) -> None:
    tunnels: list[tuple[object, ...]] = []
    monkeypatch.setattr("viser._viser.ViserTunnel", lambda *where: tunnels.append(where))
    server = Gate.at("127.0.0.1:0").serve("page")
    try:
        protocol = Subprotocol(f"viser-v{viser.__version__}")
        with connect(f"ws://127.0.0.1:{server.get_port()}/", subprotocols=[protocol]) as page:
            page.recv()
            page.send(msgspec.msgpack.encode({"type": "ShareUrlRequest"}))
        eventually(lambda: not server._websock_server._live_connections, "what the page sent is read")
    finally:
        server._thread_executor.shutdown()
        server.stop()
    assert not tunnels
