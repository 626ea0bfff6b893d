"""What smoothing promises: sooner, free, inside every limit between the samples too, and the same for the same seed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from sphere_model import clearances, random_objects

from zarm_contract.messages import Cuboid
from zarm_contract.robot import load_robot
from zarm_planner.kernels.ramps import connect_states, make_ramps, state
from zarm_planner.motion import Limits
from zarm_planner.robot_model import RobotModel
from zarm_planner.search import is_free, search
from zarm_planner.shorten import shorten
from zarm_planner.smooth import smooth_path
from zarm_planner.stop import Stop
from zarm_planner.timing import time_path
from zarm_planner.world import World

Array = NDArray[np.float64]

WALL = (Cuboid(kind="cuboid", name="wall", position=(0.6, 0.0, 0.3), size=(0.8, 0.02, 0.6)),)
LEFT = np.array([0.6, 0.6, 0.0, -1.8, 0.0, 2.4, 0.785])
RIGHT = LEFT * [-1, 1, 1, 1, 1, 1, 1]


@pytest.fixture(scope="module")
def model() -> RobotModel:
    return RobotModel.of(load_robot("panda"))


@pytest.fixture(scope="module")
def path(model: RobotModel) -> Array:
    world = World(WALL, 0.005)
    return shorten(model, world, search(model, world, LEFT, RIGHT, seed=0, stop=Stop(60)), seed=0, stop=Stop(60))


def moments(duration: float, step: float) -> Array:
    return np.linspace(0.0, duration, 2 + int(duration / step))


@pytest.mark.parametrize("jerk", [None, 20.0, 2.0])
@pytest.mark.parametrize("dt", [0.004, 0.02])
def test_the_limits_hold_between_the_samples_too(model: RobotModel, path: Array, dt: float, jerk: float | None) -> None:
    limits = Limits.of(model)
    if jerk is not None:
        limits = replace(limits, jerk=np.full(model.dof, jerk))
    motion = smooth_path(model, World(WALL, 0.005), path, limits, dt, seed=1, stop=Stop(60))
    position, velocity, acceleration = motion.at(moments(motion.duration, 0.001))
    assert np.all(np.abs(velocity) <= limits.velocity * 1.001)
    assert np.all(np.abs(acceleration) <= limits.acceleration * 1.001)
    assert np.all(np.abs(np.diff(motion.acceleration, axis=0)) <= np.diff(motion.time)[:, None] * limits.jerk * 1.01)
    assert np.all((position >= model.lower) & (position <= model.upper))


def test_it_leads_from_rest_to_rest_between_the_ends_of_the_path(model: RobotModel, path: Array) -> None:
    motion = smooth_path(model, World(WALL, 0.005), path, Limits.of(model), 0.01, seed=1, stop=Stop(60))
    np.testing.assert_allclose(motion.position[[0, -1]], path[[0, -1]], atol=1e-9)
    assert not motion.velocity[[0, -1]].any()
    assert not motion.acceleration[[0, -1]].any()
    assert np.diff(motion.time).max() <= 0.01 + 1e-12


def test_it_arrives_sooner_than_along_the_path_without_stops(model: RobotModel, path: Array) -> None:
    limits = Limits.of(model)
    motion = smooth_path(model, World(WALL, 0.005), path, limits, 0.01, seed=1, stop=Stop(60))
    assert len(path) > 2  # else there is nothing to smooth
    assert motion.duration < time_path(path, limits, 0.01, 0.03).duration


def test_the_same_seed_gives_the_same_motion(model: RobotModel, path: Array) -> None:
    world, limits = World(WALL, 0.005), Limits.of(model)
    first, again = (smooth_path(model, world, path, limits, 0.01, seed=7, stop=Stop(60)) for _ in range(2))
    np.testing.assert_array_equal(first.position, again.position)


def test_it_is_a_good_motion_also_when_there_is_no_time_left(model: RobotModel, path: Array) -> None:
    stop = Stop(60)
    stop.cancel()
    motion = smooth_path(model, World(WALL, 0.005), path, Limits.of(model), 0.01, seed=1, stop=stop)
    np.testing.assert_allclose(motion.position[[0, -1]], path[[0, -1]], atol=1e-9)


def test_a_path_that_goes_nowhere_is_a_short_rest(model: RobotModel) -> None:
    motion = smooth_path(model, World((), 0.0), LEFT[None], Limits.of(model), 0.01, seed=1, stop=Stop(60))
    assert not motion.velocity.any()
    np.testing.assert_array_equal(motion.position, [LEFT, LEFT])


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**32))
@example(3)
def test_in_random_worlds_the_motion_is_as_free_as_the_path(seed: int) -> None:
    model = RobotModel.of(load_robot("panda"))
    rng = np.random.default_rng(seed)
    objects = random_objects(12, 0.3, rng)
    world = World(objects, 0.01)
    free = [q for q in rng.uniform(model.lower, model.upper, (40, model.dof)) if is_free(model, world, q)]
    if len(free) < 2:
        return
    found = search(model, world, free[0], free[1], seed=seed, stop=Stop(1))
    if found is None:
        return
    path = shorten(model, world, found, seed=seed, stop=Stop(1))
    motion = smooth_path(model, world, path, Limits.of(model), 0.01, seed=seed, stop=Stop(60))
    position, _, _ = motion.at(moments(motion.duration, 0.005))
    assert clearances(model, objects, position).min() > 0.0


numbers = st.floats(-1.0, 1.0)


@settings(max_examples=300, deadline=None)
@given(st.lists(st.tuples(numbers, numbers, numbers, numbers), min_size=1, max_size=4))
@example([(0.0, 0.5, 0.0, 0.5), (1.0, 0.0, 0.0, 0.0)])
def test_a_ramp_joins_two_states_inside_the_limits(joints: list[tuple[float, float, float, float]]) -> None:
    start, start_velocity, end, end_velocity = np.array(joints).T.copy()
    fastest, strongest = np.full(len(joints), 1.0), np.full(len(joints), 3.0)
    ramps = make_ramps(1, len(joints))
    if not connect_states(ramps, 0, start, start_velocity, end, end_velocity, fastest, strongest, np.inf):
        return
    position, velocity = np.empty_like(start), np.empty_like(start)
    state(ramps, 0, ramps.duration[0], position, velocity)
    np.testing.assert_allclose(position, end, atol=1e-6)
    np.testing.assert_allclose(velocity, end_velocity, atol=1e-6)
    assert np.all(np.abs(ramps.acceleration[0]) <= strongest * (1 + 1e-6))
    for t in np.linspace(0.0, ramps.duration[0], 20):
        state(ramps, 0, t, position, velocity)
        assert np.all(np.abs(velocity) <= fastest + 1e-6)
