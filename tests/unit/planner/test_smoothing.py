"""What smoothing promises: sooner, free, through its vias, inside every limit between the samples too, and the same for the
same seed.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from support.examples import examples
from support.jerk import greatest_jerk
from support.planner.limits import joint_limits
from support.planner.sphere_model import clearances, random_objects
from support.tiers import sampled
from zarm_contract.messages import Cuboid
from zarm_contract.robot import load_robot
from zarm_geometry.collision import is_free
from zarm_geometry.robot_model import RobotModel
from zarm_geometry.world import World
from zarm_planner.deadline import Deadline
from zarm_planner.kernels.ramps import Ramps, connect_states, in_range, make_ramps, state, time_between
from zarm_planner.search.rrt_connect import search
from zarm_planner.search.shortcut import shortcut
from zarm_planner.timing.sampling import load
from zarm_planner.timing.smoothing import DEVIATION, Smoothing, smooth_path
from zarm_planner.timing.time_parameterization import time_path
from zarm_trajectory.arrays import Array
from zarm_trajectory.limits import Limits
from zarm_trajectory.trajectory import TimedTrajectory

WALL = (Cuboid(kind="cuboid", name="wall", position=(0.6, 0.0, 0.3), size=(0.8, 0.02, 0.6)),)
LEFT = np.array([0.6, 0.6, 0.0, -1.8, 0.0, 2.4, 0.785])
RIGHT = LEFT * [-1, 1, 1, 1, 1, 1, 1]


@pytest.fixture(scope="module")
def model() -> RobotModel:
    return RobotModel.of(load_robot("panda"))


@pytest.fixture(scope="module")
def path(model: RobotModel) -> Array:
    world = World(WALL, 0.005)
    return shortcut(
        model, world, search(model, world, LEFT, RIGHT, seed=0, deadline=Deadline(60)), seed=0, deadline=Deadline(60)
    )


def moments(duration: float, step: float) -> Array:
    return np.linspace(0.0, duration, 2 + int(duration / step))


def assert_inside(motion: TimedTrajectory, model: RobotModel, limits: Limits) -> None:
    """From rest to rest, and inside every limit at the samples and between them."""
    position, velocity, acceleration = motion.sample(moments(motion.duration, 0.001))
    assert np.all(np.abs(velocity) <= limits.velocity * 1.001)
    assert np.all(np.abs(acceleration) <= limits.acceleration * 1.001)
    assert np.all(greatest_jerk(motion) <= limits.jerk * 1.01)
    assert np.all((position >= model.lower - 1e-6) & (position <= model.upper + 1e-6))
    assert not motion.velocity[[0, -1]].any()
    assert not motion.acceleration[[0, -1]].any()


def passings(motion: TimedTrajectory, rows: Array) -> tuple[Array, Array]:
    """For each row, passed one after the other: when the motion is nearest, and how far any joint is off then."""
    t = moments(motion.duration, 0.0002)
    position, _, _ = motion.sample(t)
    # The least sum of distances over all ways to pass the rows in their order.
    off = np.abs(position[:, None] - rows[None]).max(axis=2)
    total, best = np.zeros(len(t)), []
    for k in range(len(rows)):
        total = np.minimum.accumulate(total) + off[:, k]
        best.append(total)
    at, last = [], len(t)
    for total in reversed(best):
        at.append(int(np.argmin(total[:last])))
        last = at[-1] + 1
    at.reverse()
    return t[at], off[at, range(len(rows))]


@pytest.mark.parametrize("jerk", sampled(20.0, None, 2.0))
@pytest.mark.parametrize("dt", sampled(0.02, 0.004))
def test_the_limits_hold_between_the_samples_too(model: RobotModel, path: Array, dt: float, jerk: float | None) -> None:
    limits = Limits.of(model.robot)
    if jerk is not None:
        limits = replace(limits, jerk=np.full(model.dof, jerk))
    motion = smooth_path(model, World(WALL, 0.005), path, limits, dt, seed=1, deadline=Deadline(60))
    assert_inside(motion, model, limits)


def test_it_leads_from_rest_to_rest_between_the_ends_of_the_path(model: RobotModel, path: Array) -> None:
    motion = smooth_path(model, World(WALL, 0.005), path, Limits.of(model.robot), 0.01, seed=1, deadline=Deadline(60))
    np.testing.assert_allclose(motion.position[[0, -1]], path[[0, -1]], atol=1e-9)
    assert not motion.velocity[[0, -1]].any()
    assert not motion.acceleration[[0, -1]].any()
    assert np.diff(motion.time).max() <= 0.01 + 1e-12


def test_it_arrives_sooner_than_along_the_path_without_stops(model: RobotModel, path: Array) -> None:
    limits = Limits.of(model.robot)
    motion = smooth_path(model, World(WALL, 0.005), path, limits, 0.01, seed=1, deadline=Deadline(60))
    assert len(path) > 2  # else there is nothing to smooth
    assert motion.duration < time_path(path, limits, 0.01, 0.03).duration


def test_the_same_seed_gives_the_same_motion(model: RobotModel, path: Array) -> None:
    world, limits = World(WALL, 0.005), Limits.of(model.robot)
    first, again = (smooth_path(model, world, path, limits, 0.01, seed=7, deadline=Deadline(60)) for _ in range(2))
    np.testing.assert_array_equal(first.position, again.position)


def test_it_is_a_good_motion_also_when_there_is_no_time_left(model: RobotModel, path: Array) -> None:
    stop = Deadline(60)
    stop.cancel()
    motion = smooth_path(model, World(WALL, 0.005), path, Limits.of(model.robot), 0.01, seed=1, deadline=stop)
    np.testing.assert_allclose(motion.position[[0, -1]], path[[0, -1]], atol=1e-9)


def test_a_path_that_goes_nowhere_is_a_short_rest(model: RobotModel) -> None:
    motion = smooth_path(model, World((), 0.0), LEFT[None], Limits.of(model.robot), 0.01, seed=1, deadline=Deadline(60))
    assert not motion.velocity.any()
    np.testing.assert_array_equal(motion.position, [LEFT, LEFT])


@examples(0.25)
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
    found = search(model, world, free[0], free[1], seed=seed, deadline=Deadline(1))
    if found is None:
        return
    path = shortcut(model, world, found, seed=seed, deadline=Deadline(1))
    motion = smooth_path(model, world, path, Limits.of(model.robot), 0.01, seed=seed, deadline=Deadline(60))
    position, _, _ = motion.sample(moments(motion.duration, 0.005))
    assert clearances(model, objects, position).min() > 0.0


ZIGZAG = LEFT + 0.3 * np.array([np.zeros(7), *np.random.default_rng(5).uniform(-1, 1, (6, 7))])


def test_in_free_space_it_does_not_stop_at_vias(model: RobotModel) -> None:
    motion = smooth_path(
        model, World((), 0.0), ZIGZAG, Limits.of(model.robot), 0.01, seed=1, deadline=Deadline(60), vias=range(1, 6)
    )
    times, off = passings(motion, ZIGZAG[1:6])
    assert off.max() <= DEVIATION
    _, velocity, _ = motion.sample(times)
    assert np.linalg.norm(velocity, axis=1).min() > 0.05


def test_vias_along_the_way_cost_little(model: RobotModel) -> None:
    world, limits = World((), 0.0), Limits.of(model.robot)
    line = LEFT + np.linspace(0.0, 1.0, 6)[:, None] * (RIGHT - LEFT)
    direct = smooth_path(model, world, line[[0, -1]], limits, 0.01, seed=1, deadline=Deadline(60))
    through = smooth_path(model, world, line, limits, 0.01, seed=1, deadline=Deadline(60), vias=range(1, 5))
    stopping = Smoothing(model, world, line, limits, 0.01, vias=range(1, 5)).trajectory()
    assert through.duration < 1.2 * direct.duration
    assert through.duration < 0.7 * stopping.duration


@pytest.mark.parametrize("jerk", sampled(20.0, 500.0))
@pytest.mark.parametrize("deviation", sampled(1e-3, 1e-4))
def test_low_jerk_takes_a_motion_no_further_off_its_vias(model: RobotModel, jerk: float, deviation: float) -> None:
    limits = replace(Limits.of(model.robot), jerk=np.full(model.dof, jerk))
    motion = smooth_path(
        model, World((), 0.0), ZIGZAG, limits, 0.01, seed=1, deadline=Deadline(60), vias=[2, 4], deviation=deviation
    )
    _, off = passings(motion, ZIGZAG[[2, 4]])
    assert off.max() <= deviation + 2e-4  # it is looked at every 0.2 ms, at up to 2 rad/s
    assert_inside(motion, model, limits)


def test_rows_that_are_no_vias_need_not_be_passed(model: RobotModel) -> None:
    world, limits = World((), 0.0), Limits.of(model.robot)
    through, free = (
        smooth_path(model, world, ZIGZAG, limits, 0.01, seed=1, deadline=Deadline(60), vias=vias) for vias in ([3], [])
    )
    assert free.duration < through.duration
    assert passings(free, ZIGZAG[3:4])[1].max() > DEVIATION


@pytest.mark.lengthy
@examples(0.15)
@given(st.integers(0, 2**32), st.sampled_from([None, 200.0, 20.0]), st.sampled_from([0.004, 0.01, 0.02]))
@example(3, None, 0.01)
@example(1025, None, 0.02)
def test_smoothing_passes_vias_and_is_never_slower(seed: int, jerk: float | None, dt: float) -> None:
    model = RobotModel.of(load_robot("panda"))
    rng = np.random.default_rng(seed)
    world = World(random_objects(8, 0.2, rng), 0.01)
    limits = Limits.of(model.robot)
    if jerk is not None:
        limits = replace(limits, jerk=np.full(model.dof, jerk))
    rows: list[Array] = []
    for q in rng.uniform(model.lower, model.upper, (60, model.dof)):
        if len(rows) < 5 and is_free(model, world, np.array([rows[-1], q] if rows else q)):
            rows.append(q)
    if len(rows) < 2:
        return
    path, vias = np.array(rows), range(1, len(rows) - 1)
    motion, again = (
        smooth_path(model, world, path, limits, dt, seed=seed, deadline=Deadline(60), vias=vias) for _ in range(2)
    )
    np.testing.assert_array_equal(motion.position, again.position)
    assert_inside(motion, model, limits)
    _, off = passings(motion, path[1:-1])
    assert np.all(off <= DEVIATION + 2e-4 * limits.velocity.max())
    stopping = Smoothing(model, world, path, limits, dt, vias=vias).trajectory()
    assert motion.duration <= stopping.duration * (1 + 1e-5)


def test_the_limits_are_measured_between_the_samples(model: RobotModel) -> None:
    rng = np.random.default_rng(2)
    samples = rng.normal(size=(3, 20, model.dof)) * np.array([0.01, 0.5, 5.0])[:, None, None]
    motion = TimedTrajectory(np.cumsum(rng.uniform(0.05, 0.1, 20)) - 0.05, *samples)
    t = np.linspace(motion.time[0], motion.time[-1], 20_000)
    _, velocity, acceleration = motion.sample(t[:-1])
    ample = np.full(model.dof, 1e9)
    fast = joint_limits(np.ones(model.dof), ample, ample)
    strong = joint_limits(ample, np.ones(model.dof), ample)
    assert load(motion, fast) == pytest.approx(np.abs(velocity).max(), rel=0.02)
    assert load(motion, strong) == pytest.approx(np.sqrt(np.abs(acceleration).max()), rel=0.02)


numbers = st.floats(-1.0, 1.0)


@pytest.mark.lengthy
@examples(0.5)
@given(st.lists(st.tuples(numbers, numbers, numbers, numbers), min_size=1, max_size=4))
@example([(0.0, 0.5, 0.0, 0.5), (1.0, 0.0, 0.0, 0.0)])
def test_a_ramp_joins_two_states_inside_the_limits(joints: list[tuple[float, float, float, float]]) -> None:
    start, start_velocity, end, end_velocity = np.array(joints).T.copy()
    fastest, strongest = np.full(len(joints), 1.0), np.full(len(joints), 3.0)
    ramps = make_ramps(1, len(joints))
    between = start, start_velocity, end, end_velocity, fastest, strongest
    time = time_between(*between, np.inf, np.zeros(1, np.int64))
    if not connect_states(ramps, 0, *between, time):
        return
    position, velocity = np.empty_like(start), np.empty_like(start)
    state(ramps, 0, ramps.duration[0], position, velocity)
    np.testing.assert_allclose(position, end, atol=1e-6)
    np.testing.assert_allclose(velocity, end_velocity, atol=1e-6)
    assert np.all(np.abs(ramps.acceleration[0]) <= strongest * (1 + 1e-6))
    for t in np.linspace(0.0, ramps.duration[0], 20):
        state(ramps, 0, t, position, velocity)
        assert np.all(np.abs(velocity) <= fastest + 1e-6)
    margin = 1e-9
    ends = np.array([start, end])
    swings = np.array([state_at(ramps, t) for t in np.linspace(0.0, ramps.duration[0], 200)])
    assert in_range(ramps, 0, swings.min(axis=0) - 1e-3, swings.max(axis=0) + 1e-3)
    for j in range(len(joints)):
        if swings[:, j].max() > ends[:, j].max() + margin:
            lower, upper = np.full(len(joints), -99.0), np.full(len(joints), 99.0)
            upper[j] = swings[:, j].max() - margin
            assert not in_range(ramps, 0, lower, upper)


def state_at(ramps: Ramps, t: float) -> Array:
    position = np.empty(ramps.position.shape[1])
    state(ramps, 0, t, position, np.empty_like(position))
    return position
