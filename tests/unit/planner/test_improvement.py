"""What improvement promises: each motion faster than the one before, in the same order for the same seed, until the stop."""

from __future__ import annotations

import numpy as np
import pytest

from support.planner.sphere_model import clearances
from zarm_contract.messages import Cuboid
from zarm_contract.robot import load_robot
from zarm_geometry.robot_model import RobotModel
from zarm_geometry.world import World
from zarm_planner.deadline import Deadline
from zarm_planner.search.rrt_connect import search
from zarm_planner.search.shortcut import shortcut
from zarm_planner.timing.improvement import GAIN, Improvement
from zarm_planner.timing.sampling import load
from zarm_trajectory.arrays import Array
from zarm_trajectory.limits import Limits
from zarm_trajectory.trajectory import TimedTrajectory

Route = tuple[Array, tuple[int, ...]]

WALL = (Cuboid(kind="cuboid", name="wall", position=(0.6, 0.0, 0.3), size=(0.8, 0.02, 0.6)),)
LEFT = np.array([0.6, 0.6, 0.0, -1.8, 0.0, 2.4, 0.785])
RIGHT = LEFT * [-1, 1, 1, 1, 1, 1, 1]


class Rounds(Deadline):
    """Passes after so many looks at it, so that what is done in between does not depend on the machine."""

    def __init__(self, looks: int) -> None:
        super().__init__(60.0)
        self._looks = looks

    @property
    def passed(self) -> bool:
        self._looks -= 1
        return self._looks < 0


@pytest.fixture(scope="module")
def model() -> RobotModel:
    return RobotModel.of(load_robot("panda"))


@pytest.fixture(scope="module")
def world() -> World:
    return World(WALL, 0.005)


@pytest.fixture
def improvement(model: RobotModel, world: World) -> Improvement:
    def route(k: int) -> Route:
        found = search(model, world, LEFT, RIGHT, seed=k, deadline=Deadline(60))
        return shortcut(model, world, found, seed=k, deadline=Deadline(60)), ()

    return Improvement(model, world, Limits.of(model.robot), 0.01, route, seed=0)


def staircase(improvement: Improvement, looks: int) -> list[TimedTrajectory]:
    stop, motions = Rounds(looks), []
    while (motion := improvement.faster_than(motions[-1].duration if motions else 60.0, stop)) is not None:
        motions.append(motion)
    return motions


def test_each_motion_is_faster_free_and_inside_the_limits(improvement: Improvement, model: RobotModel) -> None:
    motions = staircase(improvement, 30)
    assert len(motions) > 1
    durations = np.array([motion.duration for motion in motions])
    assert np.all(durations[1:] <= (1 - GAIN) * durations[:-1])
    for motion in motions:
        assert load(motion, Limits.of(model.robot)) <= 1.001
        np.testing.assert_allclose(motion.position[[0, -1]], [LEFT, RIGHT], atol=1e-9)
        position, _, _ = motion.sample(np.linspace(0.0, motion.duration, 400))
        assert clearances(model, WALL, position).min() > 0.0


def test_the_same_seed_tries_the_same(improvement: Improvement, model: RobotModel, world: World) -> None:
    again = Improvement(model, world, Limits.of(model.robot), 0.01, improvement.routes, seed=0)
    for one, other in zip(staircase(improvement, 10), staircase(again, 10), strict=True):
        np.testing.assert_array_equal(one.position, other.position)


def test_what_was_of_no_use_is_not_offered_again(improvement: Improvement) -> None:
    stop = Deadline(60)
    refused = [improvement.faster_than(60.0, stop) for _ in range(3)]
    durations = [motion.duration for motion in refused if motion is not None]
    assert len(set(durations)) == 3


def test_nothing_comes_after_the_stop(improvement: Improvement) -> None:
    stop = Deadline(60)
    stop.cancel()
    assert improvement.faster_than(60.0, stop) is None


def test_nothing_is_offered_where_there_is_no_route(model: RobotModel, world: World) -> None:
    improvement = Improvement(model, world, Limits.of(model.robot), 0.01, lambda _: None, seed=0)
    assert improvement.faster_than(60.0, Rounds(3)) is None


def test_faster_motions_pass_the_vias_too(model: RobotModel) -> None:
    via = np.append(LEFT[:6], 2.0)
    path = np.array([LEFT, via, RIGHT])
    improvement = Improvement(model, World((), 0.0), Limits.of(model.robot), 0.01, lambda _: (path, (1,)), seed=0)
    for motion in staircase(improvement, 5):
        position, _, _ = motion.sample(np.linspace(0.0, motion.duration, 10_000))
        assert np.abs(position - via).max(axis=1).min() < 2e-3
