"""These tests share a guarded robot. The folder needs its `__init__.py`: else its processes run on to the end."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack

import pytest

from support.cell import GIVEN_UP_AFTER, Cell
from support.harness import eventually


@pytest.fixture(scope="package")
def shared(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cell]:
    """Planner, executor and servo."""
    with ExitStack() as stack:
        execution = f"obstruction_timeout: {GIVEN_UP_AFTER}, guard_timeout: 2.0"
        yield Cell(stack, tmp_path_factory.mktemp("cell"), execution, "planner", "executor", "servo")


@pytest.fixture
def cell(shared: Cell) -> Iterator[Cell]:
    """The robot at home in an empty scene, with its client."""
    eventually(lambda: shared.client.state().guarded, "the robot is guarded")
    yield shared
    shared.home()
