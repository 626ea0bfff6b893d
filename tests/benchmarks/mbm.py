"""Search and shortening on MotionBenchMaker's problems: `python tests/benchmarks/mbm.py [--seeds 5] [--margin 0.0] [--quick]`.

CPU time of one thread, from Python, after warm-up: on an idle machine the time it takes. Needs the problems in ../shared/mbm. The margin is 0 by default, as in published
results on these problems; with one, the problems whose start or goal is not free any more are left out.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

sys.path.insert(0, str(Path(__file__).parents[1]))
import motion_bench

from zarm_planner.ik import solve_ik
from zarm_planner.robot_model import RobotModel
from zarm_planner.search import is_free, search
from zarm_planner.shorten import shorten
from zarm_planner.stop import Stop
from zarm_planner.warm_up import warm_up
from zarm_planner.world import World

Array = NDArray[np.float64]

TIMEOUT = 5.0


def main() -> None:
    """Print one table of problems and one of single kernels."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=5, help="runs of each problem")
    parser.add_argument("--margin", type=float, default=0.0, help="kept free around the robot (m)")
    parser.add_argument("--quick", action="store_true", help="one run of every third problem")
    options = parser.parse_args()
    if not motion_bench.AVAILABLE:
        sys.exit(f"there is nothing to measure: MotionBenchMaker's problems are not in {motion_bench.PROBLEMS}")
    console = Console(width=140)
    seeds, every = (1, 3) if options.quick else (options.seeds, 1)
    with tempfile.TemporaryDirectory() as folder:
        models = {name: RobotModel.of(motion_bench.robot(name, Path(folder))) for name in motion_bench.ROBOTS}
    began = time.thread_time()
    warm_up(models["panda"], lambda _: None)
    console.print(f"warm-up {time.thread_time() - began:.2f} s (long only when kernels had to be compiled)")
    console.print(problems_table(models, options.margin, seeds, every))
    console.print(kernels_table(models))


def problems_table(models: dict[str, RobotModel], margin: float, seeds: int, every: int) -> Table:
    """Solved, times (median / 95th percentile) and path length per robot and scene."""
    table = Table("robot", "scene", "solved", "search ms", "shorten ms", "together ms", "length rad", "was", "rows")
    totals: list[tuple[float, ...]] = []
    asked_in_all = 0
    for name, model in models.items():
        for scene in motion_bench.SCENES:
            runs: list[tuple[float, ...]] = []
            asked = 0
            for problem in motion_bench.problems(name, scene)[::every]:
                world = World(problem.objects, margin)
                start, goals = np.array(problem.start), np.array(problem.goals)
                if not all(is_free(model, world, q) for q in (start, *goals)):
                    continue
                asked += seeds
                for seed in range(seeds):
                    searching = time.thread_time()
                    path = search(model, world, start, goals, seed=seed, stop=Stop(TIMEOUT))
                    shortening = time.thread_time()
                    if path is None:
                        continue
                    short = shorten(model, world, path, seed=seed, stop=Stop(TIMEOUT))
                    done = time.thread_time()
                    times = (shortening - searching, done - shortening, done - searching)
                    runs.append((*times, length(short), length(path), len(short)))
            table.add_row(name, scene, *cells(runs, asked))
            totals += runs
            asked_in_all += asked
    table.add_section()
    table.add_row("all", "", *cells(totals, asked_in_all))
    return table


def cells(runs: list[tuple[float, ...]], asked: int) -> list[str]:
    """One row of the table from (search s, shorten s, together s, length, length before, rows) of each solved run."""
    columns = np.array(runs).reshape(-1, 6).T
    times = [f"{np.median(column) * 1e3:.3f} / {np.percentile(column, 95) * 1e3:.3f}" for column in columns[:3]]
    return [f"{len(runs)} / {asked}", *times, *(f"{np.mean(column):.2f}" for column in columns[3:])]


def kernels_table(models: dict[str, RobotModel]) -> Table:
    """Microseconds per call; the parts of a path are checked in one call, so the way through Python hardly counts there."""
    table = Table("robot", "configuration us", "free edge of 1 rad us", "FK us", "IK us", "16 x IK us", title="kernels")
    for name, model in models.items():
        problem = motion_bench.problems(name, "box")[0]
        world, rng = World(problem.objects, 0.0), np.random.default_rng(0)
        start = np.array(problem.start)
        steps = rng.normal(size=(2000, model.dof))
        ends = np.clip(start + steps / np.linalg.norm(steps, axis=1, keepdims=True), model.lower, model.upper)
        free = [end for end in ends if is_free(model, world, np.array((start, end)))]
        there_and_back = np.array([q for end in free for q in (start, end)])
        still = np.repeat(start[None], 2000, axis=0)
        targets = rng.uniform(model.lower, model.upper, (500, model.dof))
        poses = model.fk_tip(targets)

        def solve(
            most: int, poses: Array = poses, model: RobotModel = model, start: Array = start
        ) -> Callable[[], None]:
            def run() -> None:
                for pose in poses:
                    solve_ik(model, pose, start, world=None, max_solutions=most, seed=0, stop=Stop(TIMEOUT))

            return run

        row = (
            seconds(lambda: is_free(model, world, still)) / len(still),  # noqa: B023
            seconds(lambda: is_free(model, world, there_and_back)) / len(there_and_back),  # noqa: B023
            seconds(lambda: model.fk_tip(targets)) / len(targets),  # noqa: B023
            seconds(solve(1)) / len(poses),
            seconds(solve(16)) / len(poses),
        )
        table.add_row(name, *(f"{value * 1e6:.2f}" for value in row))
    return table


def seconds(call: Callable[[], object]) -> float:
    """The best of five runs."""
    times = []
    for _ in range(5):
        began = time.thread_time()
        call()
        times.append(time.thread_time() - began)
    return min(times)


def length(path: Array) -> float:
    """Euclidean, rad."""
    return float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum())


if __name__ == "__main__":
    main()
