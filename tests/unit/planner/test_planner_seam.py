"""What the interface of planners promises: one more is a file and a line, and it is verified like those that are there."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest

from zarm_contract.errors import InvalidRequest, PlanningFailed
from zarm_contract.messages import (
    AddObjects,
    Cylinder,
    JointGoal,
    PathConstraint,
    PlanRequest,
    PoseGoal,
    SceneEdit,
    SettingsChange,
)
from zarm_contract.robot import load_robot
from zarm_geometry.robot_model import RobotModel
from zarm_planner.context import PlanningContext
from zarm_planner.goals.problem import PlanningProblem
from zarm_planner.handlers import Handlers
from zarm_planner.planners.base import Planner
from zarm_planner.planners.registry import PLANNERS
from zarm_planner.scene.store import SceneStore
from zarm_planner.timing.time_parameterization import time_path
from zarm_trajectory.trajectory import TimedTrajectory

HOME = (0.0, 0.0, 1.5708, 0.0, 1.5708, 0.0)
SWUNG = (1.3, 0.0, 1.5708, 0.0, 1.5708, 0.0)
TO_SWUNG = JointGoal(kind="joints", position=SWUNG)


class StraightLine(Planner):
    """The straight line in joint space, whatever is in the way."""

    names: ClassVar = {"joints": "straight_line"}

    def trajectories(self, context: PlanningContext, problem: PlanningProblem) -> Iterator[TimedTrajectory]:
        line = np.array([problem.start.asked, problem.goals[0]])
        yield time_path(line, context.limits, context.dt, 0.0)


class TooFast(StraightLine):
    """The straight line in half the time that the limits allow."""

    names: ClassVar = {"joints": "too_fast"}

    def trajectories(self, context: PlanningContext, problem: PlanningProblem) -> Iterator[TimedTrajectory]:
        for trajectory in super().trajectories(context, problem):
            yield trajectory.slower(0.5)


@pytest.fixture
def handlers(tmp_path: Path) -> Handlers:
    model = RobotModel.of(load_robot("doosan_m1013"))
    planners = (*PLANNERS, StraightLine(), TooFast())
    return Handlers(model, "arm", SceneStore(tmp_path), lambda: np.array(HOME), planners=planners)


def request(planner: str | None = "straight_line", **more: object) -> PlanRequest:
    return PlanRequest.model_validate({"start": HOME, "goal": TO_SWUNG, "planner": planner, **more})


def put_post_in_the_way(handlers: Handlers) -> None:
    model = RobotModel.of(load_robot("doosan_m1013"))
    x, y, z = model.fk_tip((np.array(HOME) + SWUNG) / 2)[:3, 3].tolist()
    post = Cylinder(kind="cylinder", name="post", position=(x, y, z - 0.1), radius=0.04, length=0.4)
    handlers.edit(SceneEdit(edit=AddObjects(op="add", objects=(post,))))


def test_a_plugin_planner_is_used_by_name(handlers: Handlers) -> None:
    plan = handlers.plan(request())
    q = np.array(plan.trajectory.position)
    np.testing.assert_allclose(q[[0, -1]], (HOME, SWUNG), atol=1e-6)
    np.testing.assert_allclose(q[:, 1:], np.tile(HOME[1:], (len(q), 1)), atol=1e-9)
    assert plan.clearance > 0.0
    assert plan.timings.search == 0.0


def test_all_planners_are_listed_each_once(handlers: Handlers) -> None:
    known = ("auto", "classic", "joint_space", "multi_point", "cartesian", "straight_line", "too_fast")
    assert handlers.planners().names == known


def test_settings_can_name_it_for_all_requests(handlers: Handlers) -> None:
    handlers.change_settings(SettingsChange(planner="straight_line"))
    assert handlers.plan(request(planner=None)).timings.search == 0.0
    assert handlers.planner_name(request(planner=None)) == "straight_line"


def test_what_it_finds_is_verified_before_it_leaves(handlers: Handlers) -> None:
    put_post_in_the_way(handlers)
    with pytest.raises(PlanningFailed, match="inside post") as refused:
        handlers.plan(request(max_attempts=3))
    assert refused.value.code == "no_path"
    assert handlers.plan(request(planner=None)).clearance > 0.0


def test_a_planner_that_breaks_the_limits_is_refused(handlers: Handlers) -> None:
    with pytest.raises(PlanningFailed, match="times the allowed speed"):
        handlers.plan(request("too_fast", max_attempts=1))


def test_without_a_name_the_built_in_planners_are_used(handlers: Handlers) -> None:
    assert handlers.planner_name(request(planner=None)) == "joint_space"
    assert handlers.planner_name(request("auto")) == "joint_space"


@pytest.mark.parametrize(
    ("more", "refusal"),
    [
        (
            {"goal": PoseGoal(kind="pose", position=(0.5, 0.0, 0.5), orientation=(0.0, 1.0, 0.0, 0.0))},
            "the planner straight_line takes no goal of kind pose; ask for classic or auto",
        ),
        (
            {"path_constraint": PathConstraint(axes=(True, True, False, False, False, False))},
            "the planner straight_line takes no goal of kind joints with a path constraint; ask for joint_space or auto",
        ),
        (
            {"planner": "nobody"},
            "there is no planner nobody; ask for joint_space or straight_line or too_fast or auto",
        ),
    ],
)
def test_an_unsupported_goal_is_refused_with_planners_that_fit(
    handlers: Handlers, more: dict[str, object], refusal: str
) -> None:
    with pytest.raises(InvalidRequest, match=refusal) as refused:
        handlers.plan(request(**{"planner": "straight_line", **more}))
    assert refused.value.problem.field == "planner"


def test_settings_refuse_a_planner_that_there_is_not(handlers: Handlers) -> None:
    with pytest.raises(InvalidRequest, match="no planner nobody") as refused:
        handlers.change_settings(SettingsChange(planner="nobody"))
    assert refused.value.problem.field == "planner"
    assert handlers.change_settings(SettingsChange()).planner == "auto"
