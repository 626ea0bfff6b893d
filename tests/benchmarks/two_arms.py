"""Two arms that move at once, beside OMPL: `python tests/benchmarks/two_arms.py [--count 500] [--seed 0]`.

Two Pandas and two M1013, face to face over a table with four boxes on it. A problem leads from random free configurations of both arms to the
poses of both tips at others: one plan of zarm from request to verified motion, and one search and simplification of OMPL's
RRT-Connect in all joints, to the configuration itself, with zarm's compiled checks of edges. Both in CPU time of one thread, in turn on each problem.

Every motion of zarm is looked at again in exact geometry, at 500 samples.
"""

from __future__ import annotations

import argparse
import logging
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

from zarm_trajectory.arrays import Array

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np
from rich.console import Console
from rich.table import Table

from support.composed import composed
from support.planner import ompl_peer
from zarm_contract.errors import ZarmError
from zarm_contract.messages import (
    AddObjects,
    Cuboid,
    GroupGoal,
    GroupsGoal,
    PlanRequest,
    PoseGoal,
    SceneEdit,
    SceneObject,
)
from zarm_contract.robot import load_robot
from zarm_geometry.collision import is_free
from zarm_geometry.exact import ExactScene
from zarm_geometry.frames import pose_of
from zarm_geometry.robot_model import RobotModel
from zarm_geometry.world import World
from zarm_planner.handlers import Handlers
from zarm_planner.scene.store import SceneStore
from zarm_trajectory.trajectory import TimedTrajectory

MARGIN = 0.005
OMPL_TIMEOUT = 5.0
FACING = """
name: facing
parts:
  left: {{robot: {robot}, xyz: [{apart}, 0.0, 0.0], rpy: [0.0, 0.0, 3.14159265]}}
  right: {{robot: {robot}, xyz: [-{apart}, 0.0, 0.0]}}
"""
CELLS = {"panda": 0.55, "doosan_m1013": 0.75}
"""By robot, how far each base is from the middle of the table (m)."""


def objects(apart: float) -> list[SceneObject]:
    """A table between the arms, with boxes on it."""
    table = Cuboid(kind="cuboid", name="table", position=(0.0, 0.0, -0.06), size=(2 * apart - 0.4, 1.2, 0.1))
    boxes = [
        Cuboid(kind="cuboid", name=f"box_{x}_{y}", position=(0.12 * x, 0.3 * y, 0.09), size=(0.08, 0.1, 0.2))
        for x in (-1, 1)
        for y in (-1, 1)
    ]
    return [table, *boxes]


def configurations(model: RobotModel, world: World, rng: np.random.Generator) -> Iterator[Array]:
    """Random configurations that keep the margin, in spheres and exactly."""
    exact = ExactScene(model, world)
    lower, upper = np.maximum(model.lower, -np.pi), np.minimum(model.upper, np.pi)
    while True:
        q = rng.uniform(lower, upper)
        if is_free(model, world, q) and exact.nearest(q).distance > 0.0:
            yield q


def goal_of(model: RobotModel, q: Array) -> GroupsGoal:
    """The poses of both tips."""
    goals = []
    for name in ("left", "right"):
        pose = pose_of(model.fk_tip(q, name))
        goals.append(
            GroupGoal(group=name, goal=PoseGoal(kind="pose", position=pose.position, orientation=pose.orientation))
        )
    return GroupsGoal(kind="groups", goals=tuple(goals))


def measured(robot: str, apart: float, count: int, seed: int) -> list[str]:
    """A row of the table."""
    rng = np.random.default_rng(seed)
    with tempfile.TemporaryDirectory() as folder:
        model = RobotModel.of(load_robot(str(composed(Path(folder), FACING.format(robot=robot, apart=apart)))))
        handlers = Handlers(model, "facing", SceneStore(Path(folder)), lambda: np.array(model.robot.descriptor.home))
        handlers.warm_up(lambda _: None)
        placed = objects(apart)
        handlers.edit(SceneEdit(edit=AddObjects(op="add", objects=tuple(placed))))
        world = World(placed, MARGIN)
        exact, free = ExactScene(model, World(placed, 0.0)), configurations(model, world, rng)
        took: list[float] = []
        peer: list[float] = []
        faults: Counter[str] = Counter()
        lengths: list[tuple[float, float]] = []
        for number in range(count):
            start, end = next(free), next(free)
            request = PlanRequest(goal=goal_of(model, end), start=tuple(start.tolist()), optimize_s=0.0, seed=number)
            began = time.process_time()
            try:
                plan = handlers.plan(request)
            except ZarmError as error:
                faults[error.problem.code] += 1
                continue
            finally:
                took.append(time.process_time() - began)
            trajectory = TimedTrajectory.of(plan.trajectory, model.robot.descriptor.joints)
            dense = trajectory.positions(np.linspace(0.0, trajectory.duration, 500))
            faults["contact"] += exact.nearest(dense).distance <= 0.0
            reached = np.clip(trajectory.position[-1], model.lower, model.upper)  # a plan is rounded
            run = ompl_peer.plan(model, world, start, reached[None], OMPL_TIMEOUT, edges=True)
            if run is not None:
                peer.append(run.search + run.shortcut)
                lengths.append((plan.path_length, run.length))
    solved = count - sum(count for code, count in faults.items() if code != "contact")
    lengths_of = np.median(np.array(lengths), axis=0)
    return [
        f"two {robot}",
        f"{solved} / {count}",
        *(f"{1e3 * np.median(each):.1f} / {1e3 * np.percentile(each, 95):.1f}" for each in (took, peer)),
        f"{len(peer)} / {solved}",
        f"{lengths_of[0]:.2f} / {lengths_of[1]:.2f}",
        str(faults["contact"]),
        ", ".join(f"{code} {number}" for code, number in faults.items() if code != "contact" and number) or "-",
    ]


def main() -> None:
    """Measure both cells."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=500, help="problems of each pair of arms")
    parser.add_argument("--seed", type=int, default=0, help="of the problems")
    asked = parser.parse_args()
    logging.disable(logging.CRITICAL)
    ompl_peer.quiet(1 + asked.seed)
    table = Table(
        "arms", "solved", "plan ms", "OMPL ms", "OMPL solved", "length rad: zarm / OMPL", "contacts", "not solved"
    )
    for robot, apart in CELLS.items():
        table.add_row(*measured(robot, apart, asked.count, asked.seed))
    Console(width=160).print(table, "Times: median / 95th percentile.")


if __name__ == "__main__":
    main()
