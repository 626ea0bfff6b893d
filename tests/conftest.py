from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from executor_client import Client
from harness import ServiceProcess, router
from hypothesis import settings
from motions import KEYS

from zarm_contract.bus import Bus

settings.register_profile("untimed", deadline=None)  # nothing timed is asserted: machines differ
settings.load_profile("untimed")


@pytest.fixture
def endpoint() -> Iterator[str]:
    """A router of this test's own."""
    with router() as address:
        yield address


@pytest.fixture
def bus(endpoint: str) -> Iterator[Bus]:
    """A client session on that router."""
    with Bus(endpoint) as session:
        yield session


@pytest.fixture
def executor(endpoint: str, bus: Bus, tmp_path: Path) -> Iterator[ServiceProcess]:
    """An executor with an emulated robot."""
    with ServiceProcess("executor", endpoint, tmp_path) as process:
        process.wait_ready(bus, KEYS)
        yield process


@pytest.fixture
def client(executor: ServiceProcess, bus: Bus) -> Client:
    """A client of that executor."""
    return Client(bus)
