"""Motions that hold axes, in MotionBenchMaker's scenes: `python tests/benchmarks/path_constraint.py [--problems 20] [--timeout 1.0]`.

Start configurations are drawn at random, free in spheres. From there a random walk that keeps what is held, free as well,
leads to the goal, so that each problem has a solution; given is the pose of the tip there, with all free branches of its
inverse kinematics. CPU time of one thread, from Python, after
warm-up. Needs the problems in ../shared/mbm.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from zarm_trajectory.arrays import Array

sys.path.insert(0, str(Path(__file__).parents[1]))
from support.planner import motion_bench
from zarm_contract.messages import PathConstraint
from zarm_geometry.collision import is_free
from zarm_geometry.robot_model import RobotModel
from zarm_geometry.world import World
from zarm_planner.constraints.constrained_search import search_constrained, shortcut_constrained
from zarm_planner.constraints.constrained_timing import time_constrained
from zarm_planner.constraints.path_constraint import ConstraintManifold
from zarm_planner.deadline import Deadline
from zarm_planner.kinematics.ik import solve_ik
from zarm_trajectory.limits import Limits

DT = 0.01
STEP = 0.1
"""Rad."""
LEGS = 5
"""Of a walk."""
NEAREST = 0.5
"""Rad: a goal nearer to the start than this is no problem."""
KINDS = {
    "upright (theta_x, theta_y)": PathConstraint(axes=(True, True, False, False, False, False)),
    "at one height (z)": PathConstraint(axes=(False, False, False, False, False, True)),
    "one orientation (all theta)": PathConstraint(axes=(True, True, True, False, False, False)),
    "line along the tool's x": PathConstraint(axes=(True, True, True, False, True, True), frame="tool"),
}


def main() -> None:
    """Print one table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--problems", type=int, default=20, help="of each kind, per robot")
    parser.add_argument("--timeout", type=float, default=1.0, help="of a search (s)")
    options = parser.parse_args()
    if not motion_bench.AVAILABLE:
        sys.exit(f"there is nothing to measure: MotionBenchMaker's problems are not in {motion_bench.PROBLEMS}")
    table = Table(
        "robot", "held", "solved", "search ms", "shortcut ms", "timing ms", "together ms", "duration s", "used"
    )
    for name in motion_bench.ROBOTS:
        with tempfile.TemporaryDirectory() as folder:
            model = RobotModel.of(motion_bench.robot(name, Path(folder)))
        for kind, message in KINDS.items():
            table.add_row(name, kind, *row(model, name, message, options.problems, options.timeout))
    Console(width=150).print(table)


def row(model: RobotModel, name: str, message: PathConstraint, count: int, timeout: float) -> list[str]:
    """Solved, times (median / 95th percentile), mean duration, and the largest part of the tolerance that is used."""
    runs = []
    limits = Limits.of(model.robot)
    for seed, (world, held, start, goals) in zip(range(count), problems(model, name, message), strict=False):
        times = [time.thread_time()]
        path = search_constrained(world, held, start, goals, seed=seed, deadline=Deadline(timeout))
        times.append(time.thread_time())
        if path is None:
            continue
        path = shortcut_constrained(world, held, path, seed=seed, deadline=Deadline(timeout))
        times.append(time.thread_time())
        motion = time_constrained(
            held, path, limits, DT, free=partial(is_free, model, world), deadline=Deadline(timeout)
        )
        times.append(time.thread_time())
        if motion is not None:
            moments = np.linspace(0.0, motion.duration, 10 * len(motion.time))
            used = held.use(motion.sample(moments)[0]).max()
            runs.append((*np.diff(times), times[-1] - times[0], motion.duration, used))
    columns = np.array(runs).reshape(-1, 6).T
    if not runs:
        return [f"0 / {count}"]
    cells = [f"{np.median(column) * 1e3:.2f} / {np.percentile(column, 95) * 1e3:.2f}" for column in columns[:4]]
    return [f"{len(runs)} / {count}", *cells, f"{columns[4].mean():.2f}", f"{columns[5].max():.2f}"]


def problems(
    model: RobotModel, name: str, message: PathConstraint
) -> Iterator[tuple[World, ConstraintManifold, Array, Array]]:
    """Random ones, without end."""
    rng = np.random.default_rng(0)
    worlds = [
        World(problem.objects, 0.0)
        for scene in motion_bench.SCENES
        for problem in motion_bench.problems(name, scene)[:5]
    ]
    while True:
        world = worlds[rng.integers(len(worlds))]
        start = rng.uniform(model.lower, model.upper)
        if not is_free(model, world, start):
            continue
        held = ConstraintManifold.of(model, message, start)
        end = wander(world, held, start, rng)
        if np.linalg.norm(end - start) < NEAREST:
            continue
        found = solve_ik(
            model, model.fk_tip(end), start, world=world, max_solutions=16, seed=0, deadline=Deadline(10.0)
        )
        if len(found.solutions):
            yield world, held, start, found.solutions


def wander(world: World, held: ConstraintManifold, start: Array, rng: np.random.Generator) -> Array:
    """Where a free walk in steps of STEP ends that turns towards one random configuration after the other."""
    q = start
    for target in rng.uniform(held.model.lower, held.model.upper, (LEGS, held.model.dof)):
        while (left := np.linalg.norm(target - q)) > STEP:
            rows = held.projected(q + STEP / left * (target - q))
            if (
                rows is None
                or np.linalg.norm(rows[0] - q) > 2 * STEP
                or np.linalg.norm(target - rows[0]) > left - 0.1 * STEP
            ):
                break
            edge = np.stack((q, rows[0]))
            if held.use(edge.mean(axis=0)) > 0.5 or not is_free(held.model, world, edge):
                break
            q = rows[0]
    return q


if __name__ == "__main__":
    main()
