"""What search and shortening promise: free paths between the ends asked for, the same for the same seed, and an end in time."""

from __future__ import annotations

import itertools
import threading
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

from support.planner import generated_bench, motion_bench
from support.planner.small_arm import small_arm
from support.planner.sphere_model import clearances
from zarm_contract.errors import Cancelled, DeadlineExceeded
from zarm_contract.messages import Cuboid, SceneObject, Sphere
from zarm_contract.robot import load_robot
from zarm_geometry.collision import is_free
from zarm_geometry.kernels.collision import RESOLUTION
from zarm_geometry.robot_model import RobotModel
from zarm_geometry.world import World
from zarm_planner.deadline import Deadline
from zarm_planner.planners.free import LEG_SAMPLES
from zarm_planner.search.rrt_connect import search
from zarm_planner.search.shortcut import quickest_of, shortcut
from zarm_trajectory.arrays import Array

WALL = (Cuboid(kind="cuboid", name="wall", position=(0.6, 0.0, 0.3), size=(0.8, 0.02, 0.6)),)
"""Stands in front of the robot, so that it must go over it from one side to the other."""


@pytest.fixture(scope="module")
def model() -> RobotModel:
    return RobotModel.of(load_robot("panda"))


@pytest.fixture(scope="module")
def sides() -> tuple[Array, Array]:
    """The hand of the Panda to the left and to the right of the wall."""
    left = np.array([0.6, 0.6, 0.0, -1.8, 0.0, 2.4, 0.785])
    return left, left * [-1, 1, 1, 1, 1, 1, 1]


def length(path: Array) -> float:
    return float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum())


def dense(path: Array) -> Array:
    """The path's configurations in steps of 0.01 rad at most."""
    parts = [np.linspace(a, b, 2 + int(np.abs(b - a).max() / 0.01)) for a, b in itertools.pairwise(path)]
    return np.concatenate(parts)


def assert_free(model: RobotModel, objects: tuple[SceneObject, ...], path: Array) -> None:
    """To half the resolution, as edges promise; a part of a free edge is as free."""
    assert clearances(model, objects, dense(path)).min() > -RESOLUTION / 2
    assert np.all((path >= model.lower) & (path <= model.upper))


@pytest.mark.parametrize("seed", range(5))
def test_a_path_leads_around_obstacles(model: RobotModel, sides: tuple[Array, Array], seed: int) -> None:
    start, goal = sides
    world = World(WALL, 0.0)
    assert not is_free(model, world, np.array(sides))
    path = search(model, world, start, goal[None], seed=seed, deadline=Deadline(30.0))
    assert path is not None
    np.testing.assert_array_equal(path[0], start)
    np.testing.assert_array_equal(path[-1], goal)
    assert_free(model, WALL, path)


def test_a_margin_of_half_the_resolution_touches_nothing(model: RobotModel, sides: tuple[Array, Array]) -> None:
    world = World(WALL, RESOLUTION / 2)
    path = search(model, world, sides[0], sides[1][None], seed=0, deadline=Deadline(30.0))
    assert path is not None
    path = shortcut(model, world, path, seed=0, deadline=Deadline(30.0))
    assert clearances(model, WALL, dense(path)).min() > -1e-6


def test_a_free_straight_line_is_the_path(model: RobotModel, sides: tuple[Array, Array]) -> None:
    path = search(model, World((), 0.0), sides[0], sides[1][None], seed=0, deadline=Deadline(30.0))
    np.testing.assert_array_equal(path, np.array(sides))


def test_of_several_goals_one_that_can_be_reached_is(model: RobotModel, sides: tuple[Array, Array]) -> None:
    start, goal = sides
    caged = goal.copy()
    caged[0] -= 0.9
    x, y, z = model.fk_tip(caged)[:3, 3].tolist()
    lump = Sphere(kind="sphere", name="lump", position=(x, y, z), radius=0.1)
    objects = (*WALL, lump)
    path = search(model, World(objects, 0.0), start, np.array((caged, goal)), seed=0, deadline=Deadline(30.0))
    assert path is not None
    np.testing.assert_array_equal(path[-1], goal)
    assert_free(model, objects, path)


def test_the_same_seed_gives_the_same_path(model: RobotModel, sides: tuple[Array, Array]) -> None:
    world = World(WALL, 0.005)
    paths = [search(model, world, sides[0], sides[1][None], seed=seed, deadline=Deadline(30.0)) for seed in (1, 1, 2)]
    first, same, other = (path for path in paths if path is not None)
    np.testing.assert_array_equal(first, same)
    assert not np.array_equal(first, other)
    short, same_short = (shortcut(model, world, first, seed=3, deadline=Deadline(30.0)) for _ in range(2))
    np.testing.assert_array_equal(short, same_short)


def hopeless(model: RobotModel, goal: Array) -> World:
    """A world in which the goal collides, so that no edge ever reaches it."""
    x, y, z = model.fk_tip(goal)[:3, 3].tolist()
    return World((Sphere(kind="sphere", name="lump", position=(x, y, z), radius=0.1),), 0.0)


def test_a_hopeless_search_ends_with_its_deadline(model: RobotModel, sides: tuple[Array, Array]) -> None:
    start, goal = sides
    stop = Deadline(0.2)
    assert search(model, hopeless(model, goal), start, goal[None], seed=0, deadline=stop) is None
    assert stop.passed
    assert not stop.cancelled
    with pytest.raises(DeadlineExceeded, match=r"0\.2 s"):
        stop.check()


def test_a_hopeless_search_ends_when_another_thread_cancels_it(model: RobotModel, sides: tuple[Array, Array]) -> None:
    start, goal = sides
    stop = Deadline(60.0)
    canceller = threading.Timer(0.1, stop.cancel)
    canceller.start()
    assert search(model, hopeless(model, goal), start, goal[None], seed=0, deadline=stop) is None
    canceller.join()
    with pytest.raises(Cancelled):
        stop.check()


def test_searches_in_several_threads_do_not_disturb_each_other(model: RobotModel, sides: tuple[Array, Array]) -> None:
    world = World(WALL, 0.0)

    def find(seed: int) -> Array:
        path = search(model, world, sides[0], sides[1][None], seed=seed, deadline=Deadline(30.0))
        assert path is not None
        return shortcut(model, world, path, seed=seed, deadline=Deadline(30.0))

    with ThreadPoolExecutor(4) as pool:
        together = list(pool.map(find, range(40)))
    for seed, path in enumerate(together):
        np.testing.assert_array_equal(path, find(seed))


@pytest.mark.parametrize("seed", range(5))
def test_a_shortened_path_is_free_and_keeps_its_ends(model: RobotModel, sides: tuple[Array, Array], seed: int) -> None:
    world = World(WALL, 0.0)
    path = search(model, world, sides[0], sides[1][None], seed=seed, deadline=Deadline(30.0))
    assert path is not None
    shorter = shortcut(model, world, path, seed=seed, deadline=Deadline(30.0))
    assert length(shorter) < length(path)
    np.testing.assert_array_equal(shorter[[0, -1]], path[[0, -1]])
    assert np.all(np.abs(np.diff(shorter, axis=0)).max(axis=1) > 0.0)
    assert_free(model, WALL, shorter)


def test_a_detour_without_a_reason_becomes_a_straight_line(model: RobotModel, sides: tuple[Array, Array]) -> None:
    detour = np.array((sides[0], model.robot.descriptor.home, sides[0] + 0.1, sides[1], sides[1]))
    np.testing.assert_array_equal(
        shortcut(model, World((), 0.0), detour, seed=0, deadline=Deadline(30.0)), np.array(sides)
    )


def test_shortening_after_a_cancel_still_gives_a_free_path(model: RobotModel, sides: tuple[Array, Array]) -> None:
    world = World(WALL, 0.0)
    path = search(model, world, sides[0], sides[1][None], seed=0, deadline=Deadline(30.0))
    assert path is not None
    stop = Deadline(30.0)
    stop.cancel()
    shorter = shortcut(model, world, path, seed=0, deadline=stop)
    assert length(shorter) <= length(path)
    assert_free(model, WALL, shorter)


def test_an_arm_that_slides_and_turns_without_end_finds_its_way(tmp_path: Path) -> None:
    arm = RobotModel.of(small_arm(tmp_path))
    plate = (Cuboid(kind="cuboid", name="plate", position=(0.0, 0.6, 0.5), size=(0.01, 0.8, 1.0)),)
    start, goal = np.array([-3.0, 1.2, 0.3, 0.2]), np.array([3.0, 1.2, 0.3, 0.2])
    path = search(arm, World(plate, 0.0), start, goal[None], seed=0, deadline=Deadline(30.0))
    assert path is not None
    assert_free(arm, plate, path)


@pytest.mark.lengthy
@pytest.mark.skipif(not motion_bench.AVAILABLE, reason="MotionBenchMaker's problems are not beside the repository")
@pytest.mark.parametrize("name", motion_bench.ROBOTS)
@pytest.mark.parametrize("scene", motion_bench.SCENES)
def test_every_problem_of_motion_bench_maker_is_solved(name: str, scene: str, tmp_path: Path) -> None:
    model = RobotModel.of(motion_bench.robot(name, tmp_path))
    problems = motion_bench.problems(name, scene)
    assert problems
    for problem in problems:
        world = World(problem.objects, 0.0)
        start, goals = np.array(problem.start), np.array(problem.goals)
        path = search(model, world, start, goals, seed=0, deadline=Deadline(30.0))
        assert path is not None, problem.index
        path = shortcut(model, world, path, seed=0, deadline=Deadline(30.0))
        np.testing.assert_array_equal(path[0], start)
        np.testing.assert_array_equal(path[-1], goals[0])
        if problem.index % 10 == 1:  # the independent check is a thousand times slower
            assert_free(model, problem.objects, path)


@pytest.mark.skipif(not motion_bench.AVAILABLE, reason="MotionBenchMaker's problems are not beside the repository")
@pytest.mark.parametrize("name", motion_bench.ROBOTS)
def test_motion_bench_maker_s_goals_are_where_they_should_be(name: str, tmp_path: Path) -> None:
    model = RobotModel.of(motion_bench.robot(name, tmp_path))
    for problem in motion_bench.problems(name, "box"):
        for goal, pose in zip(problem.goals, problem.goal_poses, strict=True):
            np.testing.assert_allclose(model.fk_tip(np.array(goal))[:3, 3], pose.position, atol=1e-6)


def test_a_search_gives_up_after_the_samples_it_was_allowed(model: RobotModel, sides: tuple[Array, Array]) -> None:
    world = World(WALL, 0.0)
    assert search(model, world, sides[0], sides[1][None], seed=0, deadline=Deadline(30.0), most=1) is None
    assert search(model, world, sides[0], sides[1][None], seed=0, deadline=Deadline(30.0), most=10_000) is not None


@pytest.mark.skipif(not motion_bench.AVAILABLE, reason="MotionBenchMaker's robots are not beside the repository")
def test_most_searches_find_the_way_into_a_cage_with_few_samples(tmp_path: Path) -> None:
    model, most, seeds = RobotModel.of(motion_bench.robot("panda", tmp_path)), 300, range(20)
    problems = generated_bench.problems("panda", model, "cage", 6)
    found = [
        search(model, world, start, goal, seed=seed, deadline=Deadline(60.0), most=most) is not None
        for world, start, goal in (
            (World(problem.objects, 0.0), np.array(problem.start), np.array(problem.goals)) for problem in problems
        )
        for seed in seeds
    ]
    assert np.mean(found) > 0.6  # 0.46 if all samples are drawn anywhere


def test_only_a_path_below_the_allowed_cost_is_returned(model: RobotModel, sides: tuple[Array, Array]) -> None:
    world, (start, goal) = World(WALL, 0.0), sides

    def quickest(within: float) -> Array | None:
        fastest, seeds = model.velocity, range(10)
        return quickest_of(
            model, world, start, goal, fastest, within, seeds=seeds, deadline=Deadline(30.0), most=10_000
        ).path

    def seconds(path: Array) -> float:
        return float(np.max(np.abs(np.diff(path, axis=0)) / model.velocity, axis=1).sum())

    found = quickest(np.inf)
    assert found is not None
    again = quickest(1.2 * seconds(found))
    assert again is not None
    assert seconds(again) < 1.2 * seconds(found)
    assert_free(model, WALL, again)
    assert quickest(seconds(np.array(sides))) is None


@pytest.mark.lengthy
@pytest.mark.skipif(not motion_bench.AVAILABLE, reason="MotionBenchMaker's robots are not beside the repository")
def test_the_route_into_a_cage_is_a_short_one_whatever_the_seed(tmp_path: Path) -> None:
    """Where the first paths differ more are looked for, and one search that takes long does not end the matter."""
    model = RobotModel.of(motion_bench.robot("ur5", tmp_path))

    def seconds(path: Array) -> float:
        return float(np.max(np.abs(np.diff(path, axis=0)) / model.velocity, axis=1).sum())

    longer, seeds = [], range(20)
    found = 0
    for problem in generated_bench.problems("ur5", model, "cage", 6):
        world, start, goal = World(problem.objects, 0.0), np.array(problem.start), np.array(problem.goals[0])
        chosen = []
        for seed in seeds:
            tries, deadline = range(10 * seed, 10 * (seed + 1)), Deadline(60.0)
            path = quickest_of(
                model, world, start, goal, model.velocity, np.inf, seeds=tries, deadline=deadline, most=LEG_SAMPLES
            ).path
            if path is not None:
                chosen.append(seconds(path))
        found += len(chosen)
        longer.append(np.mean(chosen) / min(chosen))
    assert found > 0.85 * 6 * len(seeds)
    assert np.mean(longer) < 1.18  # 1.26 with the first path found
