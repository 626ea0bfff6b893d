"""The programs share a planner and an executor. The folder needs its `__init__.py`: else they run on to the end."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from support.command_line import KEYS
from support.harness import ServiceProcess, router
from support.paths import MESHES
from support.shared_up import empty_scene, observer
from zarm_runtime.bus import Bus

__all__ = ["empty_scene", "observer"]


@pytest.fixture(scope="package")
def shared(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """Their endpoint. What `zarm up` starts besides is not needed here, and a process that is forked is ready sooner."""
    folder = tmp_path_factory.mktemp("shared")
    with (
        router() as endpoint,
        Bus(endpoint) as bus,
        ServiceProcess("planner", endpoint, folder, arguments=("--meshes", str(MESHES))) as planner,
        ServiceProcess("executor", endpoint, folder) as executor,
    ):
        for service in (planner, executor):
            service.wait_ready(bus, KEYS)
        yield endpoint


@pytest.fixture
def place(shared: str) -> str:
    """The router of the robot."""
    return shared
