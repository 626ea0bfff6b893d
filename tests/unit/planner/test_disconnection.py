"""What is called without a path has none: each cell that is left out holds nothing free, and no search comes through."""

from __future__ import annotations

import math

import numpy as np
import pytest

from support.planner.sphere_model import random_objects
from support.tiers import sampled
from zarm_contract.errors import PlanningFailed
from zarm_contract.messages import Cuboid, JointGoal
from zarm_contract.robot import load_robot
from zarm_geometry.collision import is_free
from zarm_geometry.exact import ExactScene
from zarm_geometry.robot_model import RobotModel
from zarm_geometry.world import World
from zarm_planner.context import PlanningContext
from zarm_planner.deadline import Deadline
from zarm_planner.pipeline import plan
from zarm_planner.planners.free import FreePlanner
from zarm_planner.scene.planning_scene import PlanningScene
from zarm_planner.search.disconnection import _Grid, _inner_balls, find_disconnection
from zarm_planner.search.rrt_connect import search
from zarm_trajectory.arrays import Array
from zarm_trajectory.limits import Limits

MODELS = {name: RobotModel.of(load_robot(name)) for name in ("ur10e", "panda")}


def wall(name: str, low: tuple[float, float, float], high: tuple[float, float, float]) -> Cuboid:
    center = tuple((a + b) / 2 for a, b in zip(low, high, strict=True))
    size = tuple(b - a for a, b in zip(low, high, strict=True))
    return Cuboid(kind="cuboid", name=name, position=center, size=size)


def walls(gap: float, height: float) -> list[Cuboid]:
    """Walls before and behind the robot that leave a slot of twice `gap`, and a ceiling."""
    return [
        wall("front", (gap, -0.01, -0.5), (2.0, 0.01, 3.0)),
        wall("back", (-2.0, -0.01, -0.5), (-gap, 0.01, 3.0)),
        wall("ceiling", (-2.0, -2.0, height), (2.0, 2.0, height + 0.1)),
    ]


def free_beside(model: RobotModel, world: World, side: int, rng: np.random.Generator) -> Array:
    """A free configuration whose first joint points to one side of the walls."""
    while True:
        q = rng.uniform(model.lower, model.upper)
        q[0] = side * rng.uniform(0.5, 2.5)
        if is_free(model, world, q):
            return q


def test_a_goal_behind_what_blocks_joint_1_is_refused_with_it() -> None:
    model, rng = MODELS["ur10e"], np.random.default_rng(0)
    world = World(walls(0.15, 0.8), 0.005)
    start, goal = free_beside(model, world, -1, rng), free_beside(model, world, 1, rng)
    scene = PlanningScene("1-000000000000", model, world, ExactScene(model, world))
    context = PlanningContext(scene, Limits.of(model.robot), Deadline(math.inf), max_attempts=10**6)
    asked = JointGoal(kind="joints", position=tuple(goal.tolist()))
    with pytest.raises(
        PlanningFailed, match="no path to the goal: shoulder_pan_joint would have to turn through back or front"
    ):
        plan(FreePlanner(), context, start, asked)


@pytest.mark.lengthy
@pytest.mark.parametrize("name", MODELS)
@pytest.mark.parametrize("count", sampled(3, 1, 2))
def test_what_a_cell_is_left_out_for_is_touched_everywhere_in_it(name: str, count: int) -> None:
    model, rng = MODELS[name], np.random.default_rng(count)
    world = World([*walls(0.12, 0.9), *random_objects(20, 0.4, rng)], 0.0)
    grid = _Grid(model, world.rows, _inner_balls(model).before(count), count)
    exact = ExactScene(model, world)
    q = rng.uniform(model.lower, model.upper, (400, model.dof))
    blocked = q[grid.blocked_by(grid.cells(q)) >= 0]
    assert len(blocked) > 10
    assert all(exact.nearest(one, itself=False).distance < 0.0 for one in blocked[:40])


@pytest.mark.lengthy
@pytest.mark.parametrize("name", MODELS)
def test_nothing_is_called_without_a_path_that_a_search_reaches(name: str) -> None:
    model, rng = MODELS[name], np.random.default_rng(3)
    for gap, height in ((0.1, 1.0), (0.15, 1.2), (0.3, 0.8)):
        world = World(walls(gap, height), 0.0)
        start, goal = free_beside(model, world, -1, rng), free_beside(model, world, 1, rng)
        path = search(model, world, start, goal[None], seed=0, deadline=Deadline(math.inf), most=20_000)
        found = find_disconnection(model, world, start[None], goal[None], Deadline(1.0))
        assert path is None or found is None
