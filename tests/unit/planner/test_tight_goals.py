"""Goals that have a millimetre of room are reached, whatever the seed: in collision is only what is found so by a thorough search."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import count, islice
from typing import Any

import numpy as np
import pytest

from support.planner.second_opinion import link_pose
from support.tiers import sampled
from zarm_contract.errors import PlanningFailed
from zarm_contract.messages import Cuboid, JointGoal, PoseGoal, Sphere
from zarm_contract.robot import load_robot
from zarm_geometry.collision import is_free
from zarm_geometry.exact import ExactScene
from zarm_geometry.frames import pose_of
from zarm_geometry.robot_model import RobotModel
from zarm_geometry.world import World
from zarm_planner.context import PlanningContext
from zarm_planner.deadline import Deadline
from zarm_planner.goals import ends
from zarm_planner.goals.problem import PlanningProblem
from zarm_planner.kinematics.ik import IkResult
from zarm_planner.pipeline import plan
from zarm_planner.planners.free import FreePlanner
from zarm_planner.scene.planning_scene import PlanningScene
from zarm_trajectory.arrays import Array
from zarm_trajectory.limits import Limits
from zarm_trajectory.trajectory import TimedTrajectory

MODELS = {name: RobotModel.of(load_robot(name)) for name in ("panda", "doosan_m1013")}
KEPT_MARGIN = 0.001
"""Metres that the robot has to the boards below and above its tool."""
SEEDS = 20


def board(model: RobotModel, q: Array, side: int, width: float = 0.5) -> Cuboid | None:
    """A board below (-1) or above (1) the tool at `q`, ROOM away from the robot; None where that would be far from it."""
    x, y, z = model.fk_tip(q)[:3, 3].tolist()

    def at(height: float) -> Cuboid:
        place = (x, y, z + side * height)
        return Cuboid(kind="cuboid", name=f"board{side}", position=place, size=(width, width, 0.02))

    def gap(height: float) -> float:
        return ExactScene(model, World([at(height)], 0.0)).nearest(q, itself=False).distance

    near = next((height for height in np.arange(0.5, 0.0, -0.01).tolist() if gap(height) < KEPT_MARGIN), 0.5)
    if near == 0.5:
        return None
    far = near + 0.01
    for _ in range(16):
        middle = (near + far) / 2
        near, far = (middle, far) if gap(middle) < KEPT_MARGIN else (near, middle)
    return at(far)


def shelves(name: str) -> Iterator[tuple[Array, PlanningScene]]:
    """Configurations between two boards that each leave ROOM, and the scenes."""
    model, random = MODELS[name], np.random.default_rng(5)
    home = np.array(model.robot.descriptor.home)
    while True:
        q = random.uniform(np.maximum(model.lower, -2.8), np.minimum(model.upper, 2.8))
        if not is_free(model, World((), 0.005), q) or not 0.2 < model.fk_tip(q)[2, 3] < 0.9:
            continue
        boards = [item for side in (-1, 1) if (item := board(model, q, side))]
        world = World(boards, 0.005)
        exact = ExactScene(model, world)
        if len(boards) == 2 and exact.nearest(q).distance > 0.9 * KEPT_MARGIN and is_free(model, world, home):
            yield q, PlanningScene("1-000000000000", model, world, exact)


FOUND: dict[str, list[tuple[Array, PlanningScene]]] = {name: [] for name in MODELS}
MORE = {name: shelves(name) for name in MODELS}


def shelf(name: str, number: int) -> tuple[Array, PlanningScene]:
    """One of those; no more are looked for than are asked for."""
    FOUND[name].extend(islice(MORE[name], max(number + 1 - len(FOUND[name]), 0)))
    return FOUND[name][number]


def context(scene: PlanningScene, seed: int) -> PlanningContext:
    return PlanningContext(scene, Limits.of(scene.model.robot), Deadline(60.0), seed=seed)


def pose_goal(model: RobotModel, q: Array) -> PoseGoal:
    pose = pose_of(model.fk_tip(q))
    return PoseGoal(kind="pose", position=pose.position, orientation=pose.orientation)


@pytest.mark.lengthy
@pytest.mark.parametrize("name", MODELS)
@pytest.mark.parametrize("seed", sampled(*range(SEEDS)))
def test_a_goal_between_two_boards_has_a_way_out_of_there(name: str, seed: int) -> None:
    first = seed % 5 * 4
    for q, scene in (shelf(name, number) for number in range(first, first + 4)):
        home = np.array(scene.model.robot.descriptor.home)
        for goal in (JointGoal(kind="joints", position=tuple(q.tolist())), pose_goal(scene.model, q)):
            problem = PlanningProblem.of(context(scene, seed), home, goal)
            for end in problem.targets[-1]:
                assert scene.exact.nearest(end.asked).distance > 0.0
                assert is_free(scene.model, scene.world, end.free)
                assert len(end.way) == 0 or np.array_equal(end.way[-1], end.asked)


def test_the_search_looks_beyond_the_first_free_place() -> None:
    """A tool held close above a table: the search must not end just above the margin, where hardly any edge is free."""
    model = MODELS["panda"]
    q = np.array(model.robot.descriptor.home)
    table = board(model, q, -1, width=0.15)
    assert table is not None
    world = World((table,), 0.005)
    scene = PlanningScene("1-000000000000", model, world, ExactScene(model, world))
    end = ends.start_end(context(scene, 0), q, None)
    along = np.linspace(q, end.free, 200)
    free = [is_free(model, world, one) for one in along]
    first = free.index(True)
    assert all(free[first:])
    assert np.linalg.norm(end.free - q) > 1.4 * np.linalg.norm(along[first] - q)
    assert all(scene.exact.is_free(one) for one in along)


class _Unlucky(FreePlanner):
    """Finds nothing at first; `ends` are those that it was given for each attempt."""

    def __init__(self, proof: PlanningFailed | None) -> None:
        self.proof, self.ends = proof, list[tuple[ends.End, ...]]()

    def trajectories(self, context: PlanningContext, problem: PlanningProblem) -> Iterator[TimedTrajectory]:
        self.ends.append(problem.targets[-1])
        if len(self.ends) > 1:
            yield from super().trajectories(context, problem)
        elif self.proof:
            raise self.proof


@pytest.mark.parametrize("proof", [None, PlanningFailed("no path to the goal", code="no_path")])
def test_all_solutions_of_a_tight_pose_are_tried(
    proof: PlanningFailed | None,
) -> None:
    for number in range(20):
        q, scene = shelf("panda", number)
        home, goal = np.array(scene.model.robot.descriptor.home), pose_goal(scene.model, q)
        few = PlanningProblem.of(context(scene, 0), home, goal)
        if len(few.targets[-1]) < len(few.with_thorough_ik(context(scene, 0)).targets[-1]):
            break
    else:
        pytest.fail("no shelf has more ways to reach it than are considered at first")
    planner = _Unlucky(proof)
    assert plan(planner, context(scene, 0), home, goal).clearance > 0.0
    assert len(planner.ends[1]) > len(planner.ends[0])


def test_a_proof_counts_if_there_is_no_other_solution() -> None:
    q, scene = shelf("panda", 0)
    home, goal = np.array(scene.model.robot.descriptor.home), JointGoal(kind="joints", position=tuple(q.tolist()))
    planner = _Unlucky(PlanningFailed("no path to the goal", code="no_path"))
    with pytest.raises(PlanningFailed, match="no path to the goal"):
        plan(planner, context(scene, 0), home, goal)
    assert [len(given) for given in planner.ends] == [1]


def test_another_attempt_leaves_a_tight_goal_by_another_way() -> None:
    """The first may lead into a pocket that no search leaves."""
    found = (shelf("panda", number) for number in count())
    q, scene = next((q, scene) for q, scene in found if not is_free(scene.model, scene.world, q))
    home, goal = np.array(scene.model.robot.descriptor.home), JointGoal(kind="joints", position=tuple(q.tolist()))
    planner = _Unlucky(None)
    assert plan(planner, context(scene, 0), home, goal).clearance > 0.0
    (first,), (second,) = planner.ends[:2]
    assert np.array_equal(first.asked, second.asked)
    assert not np.array_equal(first.free, second.free)


def test_the_motion_into_a_tight_shelf_is_free() -> None:
    found = (shelf("panda", number) for number in count())
    q, scene = next((q, scene) for q, scene in found if not is_free(scene.model, scene.world, q))
    goal = JointGoal(kind="joints", position=tuple(q.tolist()))
    made = plan(FreePlanner(), context(scene, 0), np.array(scene.model.robot.descriptor.home), goal)
    assert 0.0 < made.clearance <= scene.exact.nearest(q).distance + 1e-5
    assert np.abs(made.trajectory.end - q).max() < 1e-6


@pytest.mark.lengthy
def test_a_pose_that_nothing_reaches_free_is_refused_in_time() -> None:
    """A block around the tip leaves no room for any posture."""
    model = MODELS["panda"]
    q = np.array(model.robot.descriptor.home)
    position = tuple(model.fk_tip(q)[:3, 3].tolist())
    away = q + 0.3 * np.where(q > (model.lower + model.upper) / 2, -1.0, 1.0)
    world = World([Cuboid(kind="cuboid", name="block", position=position, size=(0.3, 0.3, 0.3))], 0.005)
    scene = PlanningScene("1-000000000000", model, world, ExactScene(model, world))
    with pytest.raises(PlanningFailed, match=r"in all \d+ ways to reach it in collision") as refused:
        PlanningProblem.of(context(scene, 0), away, pose_goal(model, q))
    assert refused.value.code == "goal_in_collision"


def test_the_only_free_solution_is_found_by_a_later_seed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    model = MODELS["doosan_m1013"]
    q = np.array(model.robot.descriptor.home)
    pose = model.fk_tip(q)
    other = next(
        solution
        for solution in ends.solve_ik(
            model, pose, q, world=None, max_solutions=16, seed=0, deadline=Deadline(60.0)
        ).solutions
        if np.linalg.norm(elbow(model, solution) - elbow(model, q)) > 0.3
    )
    x, y, z = elbow(model, other).tolist()
    world = World([Sphere(kind="sphere", name="ball", position=(x, y, z), radius=0.1)], 0.005)
    scene = PlanningScene("1-000000000000", model, world, ExactScene(model, world))
    solve = ends.solve_ik

    def unlucky(*given: Any, seed: int, **more: Any) -> IkResult:
        found = solve(*given, seed=seed, **more)
        assert len(found.colliding)
        return found if seed == 3 else replace(found, solutions=found.solutions[:0])

    monkeypatch.setattr(ends, "solve_ik", unlucky)
    problem = PlanningProblem.of(context(scene, 0), q, pose_goal(model, q))
    assert np.allclose(problem.targets[-1][0].asked, q, atol=1e-5)


def elbow(model: RobotModel, q: Array) -> Array:
    return link_pose(model.robot, "link_3", q)[:3, 3]


def test_a_joint_goal_is_refused_only_after_many_attempts(monkeypatch: pytest.MonkeyPatch) -> None:
    found = (shelf("panda", number) for number in count())
    q, scene = next((q, scene) for q, scene in found if not is_free(scene.model, scene.world, q))
    real, refused = ends.way_out, iter(range(250))

    def narrow(context: PlanningContext, q: Array, direction: Array) -> Array | None:
        return real(context, q, direction) if next(refused, None) is None else None

    monkeypatch.setattr(ends, "edge_is_free", lambda *_: False)
    monkeypatch.setattr(ends, "way_out", narrow)
    goal = JointGoal(kind="joints", position=tuple(q.tolist()))
    home = np.array(scene.model.robot.descriptor.home)
    (end,) = PlanningProblem.of(context(scene, 0), home, goal).targets[-1]
    assert is_free(scene.model, scene.world, end.free)
