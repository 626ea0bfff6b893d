"""`zarm router`: a router alone, with zarm's settings or with a configuration of Zenoh's own."""

from __future__ import annotations

import json
from pathlib import Path
from queue import Queue

import pytest

from support.command_line import Router, the_one_line, zarm
from support.harness import eventually, free_endpoint
from support.paths import ROOT
from zarm_contract.keys import Keys
from zarm_contract.messages import SceneEdited
from zarm_runtime.bus import Bus
from zarm_runtime.session import router_config

FILE = ROOT / "deploy" / "router.json5"
KEYS = Keys("small_arm")


def reaches(one: str, other: str) -> bool:
    """Whether a message sent at one router arrives at the other within a short while."""
    arrived: Queue[str] = Queue()
    with Bus(one) as sender, Bus(other) as receiver:
        receiver.subscribe(KEYS.scene_revision, lambda key, _: arrived.put(key))
        publisher, message = sender.publisher(KEYS.scene_revision), SceneEdited(revision="1-5be0c1d2f3a4", count=0)
        return bool(eventually(lambda: publisher.put(message) or not arrived.empty(), "the message arrives"))


@pytest.mark.parametrize("arguments", [(), ("--config", str(FILE))], ids=["zarm's settings", "deploy/router.json5"])
def test_a_router_alone_carries_messages_and_ends_on_sigterm(arguments: tuple[str, ...], tmp_path: Path) -> None:
    endpoint = free_endpoint()
    with Router(tmp_path, "--listen", endpoint, *arguments) as router:
        assert endpoint in router.output()
        assert reaches(endpoint, endpoint)


def test_the_file_for_other_routers_says_what_zarm_sets_itself() -> None:
    assert json.loads(str(router_config(config=FILE))) == json.loads(str(router_config()))


def test_a_router_file_without_endpoints_listens_on_loopback(tmp_path: Path) -> None:
    bare = tmp_path / "bare.json5"
    bare.write_text("{ mode: 'router' }")
    assert router_config(config=bare).get_json("listen/endpoints") == '["tcp/127.0.0.1:7447"]'


def test_an_invalid_router_file_is_refused_with_a_sentence(tmp_path: Path) -> None:
    nonsense = tmp_path / "nonsense.json5"
    nonsense.write_text("{ mode: 'rooter' }")
    for file, reason in ((nonsense, "rooter"), (tmp_path / "missing.json5", "No such file")):
        refused = zarm("router", "--config", str(file))
        assert refused.returncode == 1
        assert str(file) in (line := the_one_line(refused.stderr))
        assert reason in line


def test_linked_routers_form_one_bus_in_any_order_and_again(tmp_path: Path) -> None:
    first, second = free_endpoint(), free_endpoint()
    with Router(tmp_path, "--listen", second, "--link", first):
        with Router(tmp_path, "--listen", first) as router:
            assert reaches(first, second)
            router.process.kill()
            router.end()
        with Router(tmp_path, "--listen", first):
            assert reaches(first, second)
            assert reaches(second, first)
