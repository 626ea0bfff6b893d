"""What a stream of joint positions says about how it goes on."""

from __future__ import annotations

import numpy as np
import pytest

from zarm_contract.robot import load_robot
from zarm_servo.tracking.joint_stream import JointStream
from zarm_servo.tracking.targets import JointTarget
from zarm_trajectory.arrays import Array

ROBOT = load_robot("ur5e")
HOME = np.array(ROBOT.descriptor.home)


def told(positions: Array, rate: float) -> JointTarget:
    """The target after these positions (N, J), so many a second."""
    stream = JointStream(ROBOT)
    for number, position in enumerate(positions):
        target = stream.moving(number / rate, position)
    return target


def wave(rate: float, seconds: float = 1.0) -> tuple[Array, Array, Array]:
    """Positions (N, J) of a motion, and where it is and how fast 0.1 s after the last."""
    times = np.arange(0.0, seconds, 1.0 / rate)
    share = np.linspace(0.1, 0.4, 6)
    later = times[-1] + 0.1
    return (
        HOME + np.sin(2.5 * times)[:, None] * share,
        HOME + np.sin(2.5 * later) * share,
        2.5 * np.cos(2.5 * later) * share,
    )


@pytest.mark.parametrize("rate", [30.0, 50.0, 100.0])
def test_a_steady_motion_is_known_ahead(rate: float) -> None:
    positions, later, speed = wave(rate)
    ahead = told(positions, rate).after(0.1)
    assert ahead.position == pytest.approx(later, abs=4e-3)
    assert ahead.velocity == pytest.approx(speed, abs=0.06)


def test_a_target_that_stands_stands() -> None:
    assert np.abs(told(np.tile(HOME, (10, 1)), 50.0).velocity).max() < 1e-9


def test_a_jump_goes_on_nowhere() -> None:
    positions = np.vstack((np.tile(HOME, (10, 1)), np.tile(HOME + 0.5, (1, 1))))
    target = told(positions, 50.0)
    assert np.array_equal(target.position, positions[-1])
    assert not target.velocity.any()


def test_what_jitters_goes_on_nowhere() -> None:
    rng = np.random.default_rng(0)
    positions = HOME + 0.01 * rng.choice((-1.0, 1.0), (20, 6))
    target = told(positions, 30.0)
    assert np.array_equal(target.position, positions[-1])
    assert not target.velocity.any()


def test_a_few_positions_say_nothing() -> None:
    assert not told(HOME + 0.01 * np.arange(3)[:, None] * np.ones(6), 30.0).velocity.any()
