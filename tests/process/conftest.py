"""A planner that the tests of one file share."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
import zenoh

from support.command_line import KEYS
from support.harness import ServiceProcess, router
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
