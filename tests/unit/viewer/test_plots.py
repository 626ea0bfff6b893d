"""What the plots tell of a moving robot."""

from __future__ import annotations

import numpy as np
import pytest

from zarm_contract.messages import GoalState, JointState
from zarm_contract.robot import load_robot
from zarm_trajectory.trajectory import TimedTrajectory
from zarm_viewer.kinematics import Chain
from zarm_viewer.picture import FAST, SLOW, speed_colours
from zarm_viewer.plots_panel import RATE, Measured, sampled, tool_speed
from zarm_viewer.watching import tracking_error


@pytest.mark.parametrize("rate", [100.0, 30.0])
def test_acceleration_and_jerk_are_told_from_velocities(rate: float) -> None:
    measured = Measured(2)
    for time in np.arange(0.0, 2.0, 1 / rate):
        measured.add(np.array([3.0 * time, 5.0 * time**2 / 2]), time)
    velocity, acceleration, jerk = measured.rates()
    assert velocity == pytest.approx([3.0 * time, 5.0 * time**2 / 2])
    assert acceleration == pytest.approx([3.0, 5.0 * time], abs=5.0 * 2 / RATE)
    assert jerk == pytest.approx([0.0, 5.0], abs=1e-6)


def test_a_short_jerk_keeps_its_height_in_the_plot() -> None:
    jerk, short, long = 50.0, 0.004, 1.0
    speed, far = jerk * short**2 / 2, jerk * short**3 / 6
    rate = jerk * short  # the acceleration that it leads to
    time = np.array([0.0, short, short + long])
    position = np.array([0.0, far, far + speed * long + rate * long**2 / 2])
    velocity, acceleration = np.array([0.0, speed, speed + rate * long]), np.array([0.0, rate, rate])
    timed = TimedTrajectory(time, *(row[:, None] for row in (position, velocity, acceleration)))
    _, (*_, seen) = sampled(timed)
    assert seen.max() == pytest.approx(jerk, rel=1e-3)


def test_exact_following_has_no_tracking_error_with_old_joints() -> None:
    position, velocity, age = (0.1, 0.2), (1.0, -2.0), 0.05
    joints = JointState(stamp=0.0, joint_names=("b", "a"), position=position, velocity=velocity)
    command = tuple(at + age * speed for at, speed in zip(position, velocity, strict=True))[::-1]
    goal = GoalState(goal_id="g", status="running", progress=0.5, elapsed=1.0, duration=2.0, joint_command=command)
    assert tracking_error(goal, joints, age, ("a", "b")) == pytest.approx([0.0, 0.0])
    assert tracking_error(goal, joints, age, ("a", "c")) is None


def test_tool_speed_of_a_turning_joint_is_that_of_the_tip() -> None:
    robot = load_robot("doosan_m1013")
    chain, home = Chain(robot), np.array(robot.descriptor.home)
    speed = np.eye(6)[0] * 0.5
    still = np.zeros((2, 6))
    turning = TimedTrajectory(np.array([0.0, 1.0]), np.stack((home, home + speed)), np.stack((speed, speed)), still)
    x, y, _ = chain.tip(home).translation()
    _, seen = tool_speed(turning, chain)
    assert seen == pytest.approx(0.5 * np.hypot(x, y), rel=1e-3)


def test_path_is_coloured_by_the_speed_of_the_tip() -> None:
    colours = speed_colours(np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.1, 0.0, 0.0], [0.15, 0.0, 0.0]]))
    assert tuple(colours[0, 0]) == FAST
    assert tuple(colours[1, 1]) == SLOW
    assert tuple(colours[2, 0]) not in (FAST, SLOW)
