"""A goal is replanned: planner, executor and servo in their own processes, and things that are put in the robot's way."""

from __future__ import annotations

import numpy as np

from support.cell import Cell
from support.planner.client import BEHIND_POST, POST, load


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
