"""A goal is replanned: planner, executor and servo in their own processes, and things that are put in the robot's way."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack

import numpy as np
import pytest

from support.cell import GIVEN_UP_AFTER, Cell
from support.harness import eventually
from support.planner.client import BEHIND_POST, POST, load

SLOWLY = 0.5
WALL = POST.model_copy(update={"name": "wall", "radius": 0.3, "length": 3.0})


@pytest.fixture(scope="module")
def shared(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cell]:
    with ExitStack() as stack:
        execution = f"obstruction_timeout: {GIVEN_UP_AFTER}, guard_timeout: 2.0"
        yield Cell(stack, tmp_path_factory.mktemp("cell"), execution, "planner", "executor", "servo")


@pytest.fixture
def cell(shared: Cell) -> Iterator[Cell]:
    eventually(lambda: shared.client.state().guarded, "the robot is guarded")
    yield shared
    shared.home()


def test_a_robot_goes_round_what_is_put_in_its_way_without_stopping(cell: Cell) -> None:
    goal = cell.way(replan=True)
    load(cell.bus, POST)
    assert cell.client.ended(goal).status == "succeeded"
    np.testing.assert_allclose(cell.client.position(), BEHIND_POST, atol=1e-6)
    states = [state for state in cell.client.goals if state.goal_id == goal]
    assert not any(state.hold for state in states)
    assert {state.status for state in states} == {"accepted", "running", "succeeded"}
    cell.assert_free_of(POST)
    assert cell.client.greatest_acceleration() < 1.05
