"""Where the robot is, is published with every motion, and less often while it stands."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import pytest

from support.trajectories import HOME, ROBOT
from zarm_contract.messages import JointState
from zarm_executor.service import JOINT_STATES_PERIOD, STANDING_PERIOD, Control
from zarm_executor.strategies.base import Measured

TICK = 0.01


@dataclass
class Robot:
    """Stands in for the state machine and for the bus: a robot whose first joint turns at `speed` (rad/s)."""

    speed: float = 0.0
    goal: bool = False
    at: float = 0.0
    told: list[JointState] = field(default_factory=list)

    def tick(self, now: float) -> Measured:
        self.at += self.speed * TICK
        return Measured(HOME + self.at * np.eye(6)[0], self.speed * np.eye(6)[0], now, now)

    def moves(self) -> bool:
        return self.goal

    def put(self, state: JointState) -> None:
        self.told.append(state)


def periods(robot: Robot) -> np.ndarray:
    """Seconds between what is published in a second of ticks."""
    control = Control(robot, ROBOT.descriptor.joints, robot)  # type: ignore[arg-type]
    for tick in range(1, 101):
        control.tick(tick * TICK)
    return np.diff([state.stamp for state in robot.told])


@pytest.mark.parametrize("robot", [Robot(speed=0.1), Robot(goal=True), Robot(speed=0.002)], ids=str)
def test_a_robot_that_moves_or_has_a_goal_is_told_at_every_tick(robot: Robot) -> None:
    np.testing.assert_allclose(periods(robot), max(TICK, JOINT_STATES_PERIOD))


def test_a_robot_that_stands_is_told_less_often() -> None:
    np.testing.assert_allclose(periods(Robot()), STANDING_PERIOD)


def test_a_robot_that_begins_to_move_is_told_at_once() -> None:
    robot = Robot()
    control = Control(robot, ROBOT.descriptor.joints, robot)  # type: ignore[arg-type]
    for tick in range(1, 3):
        control.tick(tick * TICK)
    assert len(robot.told) == 1
    robot.speed = 0.1
    control.tick(3 * TICK)
    assert len(robot.told) == 2
