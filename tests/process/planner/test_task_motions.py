"""Goals with freedom and curves of the tip over the bus: what is asked for, what comes back, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest

from support.harness import PATIENCE
from support.planner.client import HOME, KEYS, ROBOT, load, plan
from support.planner.second_opinion import link_pose
from zarm_contract.errors import InvalidRequest, PlanningFailed
from zarm_contract.messages import (
    ArcGoal,
    AttachObject,
    Cuboid,
    DetachObject,
    IkRequest,
    LineGoal,
    PathGoal,
    PathPoint,
    PlanRequest,
    Pose,
    PoseGoal,
    PoseTolerance,
    SceneEdit,
    StartState,
    TipFrame,
)
from zarm_executor.checks import executable
from zarm_geometry.frames import matrix
from zarm_runtime.bus import Bus

TIP = link_pose(ROBOT, ROBOT.descriptor.tip_link, HOME)
POSITION_ONLY = PoseTolerance(orientation=("free", "free", "free"))


def near(*shift: float) -> tuple[float, float, float]:
    x, y, z = (TIP[:3, 3] + shift).tolist()
    return x, y, z


def test_position_alone_is_a_goal_and_the_choice_is_reported(planner: Bus) -> None:
    load(planner)
    goal = PoseGoal(kind="pose", position=near(0.1, 0.2, -0.1), tolerance=POSITION_ONLY)
    answer = plan(planner, PlanRequest(start=HOME, goal=goal))
    assert answer.tip.position == pytest.approx(goal.position, abs=1e-5)
    assert answer.goal_deviation is not None
    assert answer.goal_deviation[3:] == pytest.approx((0.0, 0.0, 0.0), abs=1e-5)
    executable(answer.trajectory, ROBOT)


def test_inverse_kinematics_takes_the_same_freedom(planner: Bus) -> None:
    load(planner)
    request = IkRequest(
        poses=(Pose(position=near(0.1, 0.2, -0.1)),), tolerance=POSITION_ONLY, near=HOME, max_solutions=4
    )
    (solutions,) = planner.call(KEYS.ik, request, timeout=PATIENCE).solutions
    assert len(solutions) == 4
    for q in solutions:
        tip = link_pose(ROBOT, ROBOT.descriptor.tip_link, q)
        assert tip[:3, 3] == pytest.approx(near(0.1, 0.2, -0.1), abs=1e-5)


def test_freedom_is_not_computed_by_torch(planner: Bus) -> None:
    request = IkRequest(poses=(Pose(position=near(0, 0, 0)),), tolerance=POSITION_ONLY, near=HOME, device="cpu")
    with pytest.raises(InvalidRequest) as refused:
        planner.call(KEYS.ik, request, timeout=PATIENCE)
    assert refused.value.problem.field == "device"


def test_attached_object_is_brought_to_a_pose(planner: Bus) -> None:
    part = Cuboid(kind="cuboid", name="part", position=near(0.0, 0.0, -0.1), size=(0.02, 0.02, 0.1))
    load(planner, part)
    attach = AttachObject(op="attach", name="part", joints=HOME, touch_links=("link_6",))
    planner.call(KEYS.scene_edit, SceneEdit(edit=attach), timeout=PATIENCE)
    held = np.linalg.inv(TIP) @ matrix(part.position)
    goal = PoseGoal(
        kind="pose", position=near(0.0, 0.2, -0.1), orientation=(0.0, 0.0, 0.0, 1.0), tip=TipFrame(link="part")
    )
    try:
        answer = plan(planner, PlanRequest(start=HOME, goal=goal))
    finally:
        planner.call(
            KEYS.scene_edit, SceneEdit(edit=DetachObject(op="detach", name="part", joints=HOME)), timeout=PATIENCE
        )
    end = link_pose(ROBOT, ROBOT.descriptor.tip_link, answer.trajectory.position[-1]) @ held
    assert end[:3, 3] == pytest.approx(goal.position, abs=1e-5)


@pytest.mark.parametrize(
    "goal",
    [
        LineGoal(kind="line", position=near(0.0, 0.3, 0.0), speed=0.1),
        ArcGoal(kind="arc", position=near(0.0, 0.2, 0.0), via=near(0.07, 0.1, 0.0)),
        PathGoal(
            kind="path", points=(PathPoint(position=near(0.0, 0.2, 0.0)), PathPoint(position=near(0.0, 0.2, -0.1)))
        ),
    ],
    ids=["line", "arc", "path"],
)
def test_curve_is_planned_and_what_comes_back_can_be_executed(
    planner: Bus, goal: LineGoal | ArcGoal | PathGoal
) -> None:
    load(planner)
    answer = plan(planner, PlanRequest(start=HOME, goal=goal))
    executable(answer.trajectory, ROBOT)
    assert answer.tool is not None
    assert answer.tool.speed == (goal.speed or ROBOT.descriptor.tool.speed)
    end = goal.points[-1].position if isinstance(goal, PathGoal) else goal.position
    assert answer.tip.position == pytest.approx(end, abs=1e-5)


def test_curve_that_cannot_be_followed_says_how_far_it_can(planner: Bus) -> None:
    load(planner)
    with pytest.raises(PlanningFailed) as failed:
        plan(planner, PlanRequest(start=HOME, goal=LineGoal(kind="line", position=near(3.0, 0.0, 0.0))))
    assert failed.value.problem.fraction is not None
    assert 0.0 < failed.value.problem.fraction < 1.0


def test_start_in_motion_is_refused_for_a_curve(planner: Bus) -> None:
    state = StartState(position=HOME, velocity=(0.1,) * 6, acceleration=(0.0,) * 6)
    with pytest.raises(InvalidRequest) as refused:
        plan(planner, PlanRequest(start_state=state, goal=LineGoal(kind="line", position=near(0.1, 0.0, 0.0))))
    assert refused.value.problem.field == "start_state"
