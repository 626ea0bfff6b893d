"""What the last gate promises: a motion passes only if all that was asked of it holds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from support.examples import examples
from support.planner.small_arm import small_arm
from zarm_contract.messages import Cuboid, SceneObject, Sphere
from zarm_geometry.exact import ExactScene
from zarm_geometry.robot_model import RobotModel
from zarm_geometry.world import World
from zarm_planner.kernels.quintic import followed
from zarm_planner.kernels.verification import furthest_outside
from zarm_planner.timing.time_parameterization import time_path
from zarm_planner.verification.verify import VerificationFailed, verify
from zarm_trajectory.limits import Limits
from zarm_trajectory.trajectory import TimedTrajectory

START = np.array([0.0, 0.3, 0.4, 0.1])
GOAL = START + (0.8, 0.2, -0.3, 0.05)


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> RobotModel:
    return RobotModel.of(small_arm(tmp_path_factory.mktemp("robot")))


@pytest.fixture(scope="module")
def motion(model: RobotModel) -> TimedTrajectory:
    return time_path(np.array((START, GOAL)), Limits.of(model.robot), 0.02, 0.0)


def clearance(model: RobotModel, motion: TimedTrajectory, *objects: SceneObject, scale: float = 1.0) -> float:
    scene = ExactScene(model, World(objects, 0.005))
    return verify(motion, START, GOAL, Limits.of(model.robot, scale), scene, lambda: None)


def test_a_motion_in_order_passes_with_its_smallest_distance(model: RobotModel, motion: TimedTrajectory) -> None:
    tip = model.fk_tip((START + GOAL) / 2)[:3, 3]
    ball = Sphere(kind="sphere", name="ball", position=(*tip[:2].tolist(), float(tip[2]) + 0.15), radius=0.05)
    dense, _, _ = motion.sample(np.linspace(0.0, motion.duration, 2000))
    closest = ExactScene(model, World([ball], 0.0)).nearest(dense).distance
    assert clearance(model, motion, ball) == pytest.approx(closest, abs=1e-4)


def test_what_stands_in_the_way_between_two_samples_is_met(model: RobotModel) -> None:
    """A motion of two samples, at rest in both: only the way between them tells how fast it is."""
    motion = TimedTrajectory(np.array([0.0, 5.0]), np.array((START, GOAL)), np.zeros((2, 4)), np.zeros((2, 4)))
    x, y, z = model.fk_tip((START + GOAL) / 2)[:3, 3].tolist()
    sheet = Cuboid(kind="cuboid", name="sheet", position=(x, y, z), size=(0.001, 0.001, 0.05))
    assert clearance(model, motion) > 0.0
    with pytest.raises(VerificationFailed, match=r"rod would be .* inside sheet at 2\.\d\d s"):
        clearance(model, motion, sheet)


@examples(0.5)
@given(seed=st.integers(0, 2**32 - 1))
def test_no_point_moves_further_than_asked_between_checks(seed: int) -> None:
    rng = np.random.default_rng(seed)
    time = np.cumsum(rng.uniform(0.01, 1.0, 6)) - 0.01
    wild = TimedTrajectory(time, *rng.normal(size=(3, 6, 3)) * rng.uniform(0.0, 3.0, (3, 1, 3)))
    reach, most = rng.uniform(0.1, 1.0, 3), rng.uniform(0.001, 0.1)
    times, positions = followed(wild.time, wild.position, wild.velocity, wild.acceleration, reach, most)
    np.testing.assert_allclose(positions, wild.positions(times), atol=1e-12)
    assert set(wild.time) <= set(times)
    between = wild.positions(np.linspace(times[:-1], times[1:], 31).T.ravel()).reshape(len(times) - 1, 31, 3)
    moved = np.abs(np.diff(between, axis=1)) @ reach
    assert np.all(moved.sum(axis=1) <= most * (1 + 1e-9))


def test_a_motion_over_the_limits_is_refused(model: RobotModel, motion: TimedTrajectory) -> None:
    with pytest.raises(VerificationFailed, match=r"needs 2\.\d+ times the allowed speed"):
        clearance(model, motion, scale=0.4)


@pytest.mark.parametrize(
    ("at", "message"), [(0, "starts away from the start"), (-1, "ends away from the goal"), (20, "allowed speed")]
)
@pytest.mark.parametrize("wrong", [np.nan, np.inf, 7.0])
def test_one_wrong_position_is_refused(
    model: RobotModel, motion: TimedTrajectory, at: int, message: str, wrong: float
) -> None:
    position = motion.position.copy()
    position[at, 1] = wrong
    with pytest.raises(VerificationFailed, match=message):
        clearance(model, replace(motion, position=position))


@pytest.mark.parametrize("rows", ["velocity", "acceleration"])
@pytest.mark.parametrize("wrong", [np.nan, np.inf])
def test_a_rate_that_is_no_number_is_refused(
    model: RobotModel, motion: TimedTrajectory, rows: str, wrong: float
) -> None:
    values = getattr(motion, rows).copy()
    values[len(values) // 2, 2] = wrong
    with pytest.raises(VerificationFailed, match="allowed speed"):
        clearance(model, replace(motion, **{rows: values}))


def test_a_motion_that_does_not_end_at_rest_is_refused(model: RobotModel, motion: TimedTrajectory) -> None:
    velocity = motion.velocity.copy()
    velocity[-1, 0] = 1e-3
    with pytest.raises(VerificationFailed, match="does not end at rest"):
        clearance(model, replace(motion, velocity=velocity))


def test_a_joint_out_of_its_range_is_refused(model: RobotModel) -> None:
    beyond = START + (0.0, 2.0, 0.0, 0.0)
    motion = time_path(np.array((START, beyond)), Limits.of(model.robot), 0.02, 0.0)
    scene = ExactScene(model, World([], 0.0))
    with pytest.raises(VerificationFailed, match=r"takes bend 0\.3000 rad out of its range"):
        verify(motion, START, beyond, Limits.of(model.robot), scene, lambda: None)


def test_the_furthest_joint_outside_its_range_is_the_one_named() -> None:
    rng = np.random.default_rng(0)
    lower, upper = np.array((-1.0, -2.0, 0.0)), np.array((1.0, 0.5, 3.0))
    for _ in range(50):
        position = rng.uniform(-2.5, 3.5, (9, 3))
        outside = np.maximum(lower - position, position - upper)
        assert furthest_outside(position, lower, upper) == (outside.max(), *np.unravel_index(outside.argmax(), (9, 3)))
    position[4, 1] = np.nan
    amount, *where = furthest_outside(position, lower, upper)
    assert np.isnan(amount)
    assert where == [4, 1]
