"""An executor that the tests of one file share."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

from support.executor.client import Client
from support.harness import ServiceProcess, router
from support.trajectories import HOME, KEYS, rest_to_rest
from zarm_runtime.bus import Bus


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """The router of the executor that is shared."""
    with (
        router() as address,
        Bus(address) as bus,
        ServiceProcess("executor", address, tmp_path_factory.mktemp("executor")) as process,
    ):
        process.wait_ready(bus, KEYS)
        yield address
        assert process.process.poll() is None


@pytest.fixture
def shared(place: str) -> Iterator[Client]:
    """A client of the shared executor, for tests that hardly move it: each finds it idle, and the robot at home."""
    with Bus(place) as bus:
        client = Client(bus)
        yield client
        client.mode("idle")
        at = client.position()
        if not np.allclose(at, HOME, atol=1e-6):
            assert client.ended(client.execute(rest_to_rest(HOME, at))).status == "succeeded"
