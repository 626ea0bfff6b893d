"""What a robot that is stuck is steered for: points on a global plan, until the target can be followed directly again."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from concurrent.futures import Executor, Future
from typing import Any, TypeVar

import numpy as np
import pytest

from zarm_contract.errors import DeadlineExceeded, PlanningFailed
from zarm_contract.robot import load_robot
from zarm_geometry.robot_model import RobotModel
from zarm_servo.tracking.global_plan import GlobalPlan
from zarm_servo.tracking.local_goal import LocalGoal
from zarm_servo.tracking.targets import JointTarget, PoseTarget, Target, TwistTarget
from zarm_trajectory.arrays import Array

T = TypeVar("T")

MODEL = RobotModel.of(load_robot("doosan_m1013"))
START = np.array(MODEL.robot.descriptor.home)
PATH = START + np.linspace(0.0, 1.0, 51)[:, None] * np.array((1.0, 0.2, 0.0, 0.0, 0.0, 0.0))
TARGET = PoseTarget(MODEL.fk_tip(PATH[-1]))
SECOND = 250


class AtOnce(Executor):
    """Runs what it is given before it returns."""

    def submit(self, fn: Callable[..., T], /, *args: Any, **kwargs: Any) -> Future[T]:
        done: Future[T] = Future()
        try:
            done.set_result(fn(*args, **kwargs))
        except PlanningFailed as error:
            done.set_exception(error)
        return done


class Stuck:
    """The local goal of a robot, and the time limits of what it asked for; `known` says whether there is a plan, and
    `takes` how long (s) a planner needs for it.
    """

    def __init__(self, *, known: bool = True, takes: float = 0.0) -> None:
        self.limits: list[float] = []
        self.known, self.takes = known, takes
        self.local_goal = LocalGoal(MODEL, self._find, lambda *_: True, AtOnce())

    @property
    def asked(self) -> int:
        return len(self.limits)

    def _find(self, target: PoseTarget | JointTarget, _start: Array, _distance: float, timeout: float) -> GlobalPlan:
        self.limits.append(timeout)
        if not self.known:
            raise PlanningFailed("there is a wall", code="goal_in_collision")
        if timeout < self.takes:
            return GlobalPlan(PATH[:2], target, DeadlineExceeded("the goal is in a narrow place"))
        return GlobalPlan(PATH, target)

    def stay(self, target: Target, at: Array = START, steps: int = SECOND, revision: str = "1-a") -> Target | None:
        """What it is steered for after so many steps in which it has not moved."""
        return [self.local_goal.target(target, at, revision) for _ in range(steps)][-1]


def test_a_robot_that_moves_on_is_led_to_the_target_itself() -> None:
    robot = Stuck()
    assert all(robot.local_goal.target(TARGET, position, "1-a") is TARGET for position in np.repeat(PATH, 10, axis=0))
    assert robot.asked == 0


@pytest.mark.parametrize(("seconds", "asks"), [(8.0, True), (5.0, False)])
def test_a_robot_moving_too_slowly_is_stuck(seconds: float, asks: bool) -> None:
    robot = Stuck()
    way = np.linspace(PATH[0], PATH[-1], int(seconds * SECOND))
    for position in way[: 3 * SECOND + 1]:
        robot.local_goal.target(TARGET, position, "1-a")
    assert bool(robot.asked) == asks


def test_a_robot_behind_a_moving_target_is_not_stuck() -> None:
    robot = Stuck()
    for position, ahead in itertools.pairwise(np.linspace(PATH[0], PATH[-1], 5 * SECOND)):
        robot.local_goal.target(PoseTarget(MODEL.fk_tip(ahead + (PATH[-1] - PATH[0]))), position, "1-a")
    assert robot.asked == 0


def test_a_robot_that_is_stuck_is_led_along_a_plan_to_its_end() -> None:
    robot = Stuck()
    point = robot.stay(TARGET, steps=SECOND // 2)
    assert isinstance(point, JointTarget)
    assert 0.1 < np.abs(point.position - START).max() < 1.0
    for position in np.repeat(PATH, 10, axis=0):
        point = robot.local_goal.target(TARGET, position, "1-a")
    assert isinstance(point, JointTarget)
    np.testing.assert_allclose(point.position, PATH[-1])
    assert robot.asked == 1


def test_near_the_end_a_moving_target_is_followed_directly() -> None:
    robot = Stuck()
    robot.stay(TARGET, steps=SECOND // 2)
    for position in np.repeat(PATH[:-2], 10, axis=0):
        robot.local_goal.target(TARGET, position, "1-a")
    pose = TARGET.pose.copy()
    pose[2, 3] += 0.02
    moved = PoseTarget(pose)
    assert robot.local_goal.target(moved, PATH[-2], "1-a") is moved


def test_an_unreachable_target_is_retried_in_another_scene() -> None:
    robot = Stuck(known=False)
    assert robot.stay(TARGET) is TARGET
    robot.stay(TARGET)
    assert robot.asked == 1
    assert robot.local_goal.problem is not None
    assert robot.local_goal.problem.code == "goal_in_collision"
    robot.known = True
    assert isinstance(robot.stay(TARGET, revision="2-a"), JointTarget)
    assert robot.local_goal.problem is None


def test_a_plan_out_of_time_leads_near_and_gets_twice_as_long() -> None:
    robot = Stuck(takes=1.5)
    point = robot.stay(TARGET, steps=10 * SECOND)
    assert robot.limits[0] < robot.takes
    assert robot.limits == [robot.limits[0] * 2**ask for ask in range(len(robot.limits))]
    assert robot.limits[-1] >= robot.takes
    assert isinstance(point, JointTarget)


def test_planning_time_for_a_target_is_bounded() -> None:
    robot = Stuck(takes=np.inf)
    robot.stay(TARGET, steps=60 * SECOND)
    assert len(robot.limits) > 6
    assert robot.limits[-1] == robot.limits[-3] < 10.0


def test_who_jogs_is_never_led_elsewhere() -> None:
    robot, twist = Stuck(), TwistTarget(np.zeros(6))
    assert robot.stay(twist) is twist
    assert robot.asked == 0


def test_after_a_jump_the_old_plan_is_not_waited_for() -> None:
    asked: list[Future[GlobalPlan]] = []

    class Slow(Executor):
        """Never finishes what it is given."""

        def submit(self, fn: Callable[..., T], /, *args: Any, **kwargs: Any) -> Future[T]:
            asked.append(Future())
            return asked[-1]  # type: ignore[return-value]

    local_goal = LocalGoal(MODEL, lambda *_: GlobalPlan(PATH, TARGET), lambda *_: True, Slow())
    for _ in range(SECOND):
        local_goal.target(TARGET, START, "1-a")
    assert len(asked) == 1
    elsewhere = PoseTarget(MODEL.fk_tip(PATH[-1] - (PATH[-1] - PATH[0]) * 2))
    for _ in range(SECOND):
        local_goal.target(elsewhere, START, "1-a")
    before, now = asked
    assert before.cancelled()
    now.set_result(GlobalPlan(PATH, elsewhere))
    assert isinstance(local_goal.target(elsewhere, START, "1-a"), JointTarget)
