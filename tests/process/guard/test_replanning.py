"""A goal is replanned: planner, executor and servo in their own processes, and things that are put in the robot's way."""

from __future__ import annotations

import numpy as np
import pytest

from support.cell import SLOWLY, Cell
from support.harness import eventually
from support.planner.client import BEHIND_POST, HOME, POST, load, plan
from support.planner.second_opinion import link_pose
from support.trajectories import ROBOT
from zarm_contract.messages import PathConstraint, PlanRequest, PoseGoal, Sphere
from zarm_geometry.frames import pose_of
from zarm_geometry.robot_model import RobotModel

MODEL = RobotModel.of(ROBOT)
TURNED = 0.9, -0.2, 1.6, 0.0, 1.4, 0.5


def test_replanning_avoids_a_new_obstacle_without_a_stop(cell: Cell) -> None:
    goal = cell.way(replan=True)
    load(cell.bus, POST)
    assert cell.client.ended(goal).status == "succeeded"
    np.testing.assert_allclose(cell.client.position(), BEHIND_POST, atol=1e-6)
    eventually(lambda: cell.client.goals[-1].done, "the end has been told")
    states = [state for state in cell.client.goals if state.goal_id == goal]
    assert not any(state.hold for state in states)
    assert {state.status for state in states} == {"accepted", "running", "succeeded"}
    cell.assert_free_of(POST)
    assert cell.client.greatest_acceleration() < 1.05


@pytest.mark.slow  # as in unit/servo/test_replanning.py
def test_replanning_keeps_a_carried_glass_upright(cell: Cell) -> None:
    upright = PathConstraint(axes=(True, True, False, False, False, False))
    goal = cell.way(replan=True, path_constraint=upright)
    load(cell.bus, POST)
    assert cell.client.ended(goal).status == "succeeded"
    np.testing.assert_allclose(cell.client.position(), BEHIND_POST, atol=1e-6)
    cell.assert_free_of(POST)
    commanded = np.array([state.joint_command for state in cell.client.goals if state.goal_id == goal])
    axes = MODEL.fk_tip(commanded)[:, :3, 2]
    assert (
        np.arccos(np.clip(axes @ axes[0], -1.0, 1.0)).max() < 0.04
    )  # 0.02 rad about each of two axes, from where it was planned


@pytest.mark.slow  # as in unit/servo/test_replanning.py
def test_replanning_reaches_a_pose_with_other_joints(cell: Cell) -> None:
    tip = pose_of(MODEL.fk_tip(np.array(TURNED)))
    made = plan(
        cell.bus,
        PlanRequest(
            start=HOME,
            goal=PoseGoal(kind="pose", position=tip.position, orientation=tip.orientation),
            velocity_scale=SLOWLY,
        ),
    )
    elbow = link_pose(ROBOT, "link_3", made.trajectory.position[-1])[:3, 3].tolist()
    goal = cell.client.execute(plan_id=made.plan_id, replan=True)
    cell.client.under_way(goal, 0.05)
    load(cell.bus, Sphere(kind="sphere", name="ball", position=tuple(elbow), radius=0.05))
    assert cell.client.ended(goal).status == "succeeded"
    np.testing.assert_allclose(MODEL.fk_tip(cell.client.position())[:3, 3], tip.position, atol=1e-3)
    assert np.abs(np.array(cell.client.position()) - made.trajectory.position[-1]).max() > 0.5
