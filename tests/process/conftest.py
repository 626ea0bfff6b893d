"""A planner, and a `zarm up`, that the tests of one file share."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
import zenoh

from support.command_line import KEYS, Up
from support.harness import ServiceProcess, free_endpoint, router
from zarm_contract.messages import ClearScene, SceneEdit, SceneEdited
from zarm_runtime.bus import Bus
from zarm_runtime.session import open_client


@pytest.fixture(scope="module")
def place() -> Iterator[str]:
    """The router of the planner that most tests share."""
    with router() as address:
        yield address


@pytest.fixture(scope="module")
def planner(place: str, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Bus]:
    """A session to a planner that is ready; each test gives it the scene it needs, and it must outlive them all."""
    with Bus(place) as bus, ServiceProcess("planner", place, tmp_path_factory.mktemp("planner")) as process:
        process.wait_ready(bus, KEYS)
        yield bus
        assert process.process.poll() is None


@pytest.fixture(scope="module")
def foreign(planner: Bus, place: str) -> Iterator[zenoh.Session]:
    """A client that knows nothing of zarm."""
    session = open_client(place)
    yield session
    session.close()  # type: ignore[no-untyped-call]


@pytest.fixture(scope="module")
def up(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Up]:
    """`zarm up`, which the tests of one file share."""
    with Up(free_endpoint(), tmp_path_factory.mktemp("up")) as stack:
        yield stack


@pytest.fixture(scope="module")
def observer(up: Up) -> Iterator[Bus]:
    """A client on its bus."""
    with Bus(up.endpoint) as session:
        yield session


@pytest.fixture
def empty_scene(observer: Bus) -> None:
    """Its scene is empty."""
    observer.call(KEYS.scene_edit, SceneEdit(edit=ClearScene(op="clear")), SceneEdited, timeout=5)
