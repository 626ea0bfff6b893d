"""How soon motions arrive on MotionBenchMaker's problems: `python tests/benchmarks/arrival.py [--every 2] [--margin 0.0]`.

Each path is timed both ways in turn: smoothed, and by TOPPRA along the path with rounded corners (0.1 rad off at most), both
under the same limits of velocity, acceleration and jerk. Both are then verified on exact geometry. One thread, from
Python, after warm-up; needs the problems in ../shared/mbm.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

sys.path.insert(0, str(Path(__file__).parents[1]))
import motion_bench

from zarm_planner.exact import ExactScene
from zarm_planner.motion import Limits, Motion
from zarm_planner.robot_model import RobotModel
from zarm_planner.search import is_free, search
from zarm_planner.shorten import shorten
from zarm_planner.smooth import smooth_path
from zarm_planner.stop import Stop
from zarm_planner.timing import time_path
from zarm_planner.verify import VerificationFailed, verify
from zarm_planner.warm_up import warm_up
from zarm_planner.world import World

Array = NDArray[np.float64]
T = TypeVar("T")

DT = 0.01
COLUMNS = ("robot", "scene", "paths", "smooth s", "TOPPRA s", "ratio, worst", "smooth ms", "TOPPRA ms", "verify ms")


def main() -> None:
    """Print one table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--every", type=int, default=2, help="take every so-many-th problem")
    parser.add_argument("--margin", type=float, default=0.0, help="kept free around the robot (m)")
    options = parser.parse_args()
    if not motion_bench.AVAILABLE:
        sys.exit(f"there is nothing to measure: MotionBenchMaker's problems are not in {motion_bench.PROBLEMS}")
    with tempfile.TemporaryDirectory() as folder:
        models = {name: RobotModel.of(motion_bench.robot(name, Path(folder))) for name in motion_bench.ROBOTS}
    warm_up(models["panda"], lambda _: None)
    table = Table(*COLUMNS, "refused: smooth", "TOPPRA")
    everything: list[Array] = []
    for name, model in models.items():
        for scene in motion_bench.SCENES:
            runs = [
                run(model, problem, options.margin) for problem in motion_bench.problems(name, scene)[:: options.every]
            ]
            rows = np.array([row for row in runs if row is not None])
            table.add_row(name, scene, *cells(rows))
            everything.append(rows)
    table.add_section()
    table.add_row("all", "", *cells(np.concatenate(everything)))
    Console(width=150).print(table)


def run(model: RobotModel, problem: motion_bench.Problem, margin: float) -> tuple[float, ...] | None:
    """Durations (s), times to compute and to verify (s) and refusals, of one problem; None where the margin rules it out."""
    world, limits = World(problem.objects, margin), Limits.of(model)
    scene = ExactScene(model, world)
    start, goals = np.array(problem.start), np.array(problem.goals)
    if not all(is_free(model, world, end) for end in (start, *goals)):
        return None
    found = search(model, world, start, goals, seed=0, stop=Stop(60.0))
    if found is None:
        return None
    path = shorten(model, world, found, seed=0, stop=Stop(60.0))

    def refused(motion: Motion) -> bool:
        try:
            verify(motion, path[0], path[-1], limits, scene, lambda: None)
        except VerificationFailed:
            return True
        return False

    smooth, smooth_seconds = timed(lambda: smooth_path(model, world, path, limits, DT, seed=0, stop=Stop(60.0)))
    rounded, rounded_seconds = timed(lambda: time_path(path, limits, DT, 0.1))
    smooth_refused, verify_seconds = timed(lambda: refused(smooth))
    return (
        smooth.duration, rounded.duration, smooth_seconds, rounded_seconds, verify_seconds, smooth_refused, refused(rounded),
    )  # fmt: skip


def timed(call: Callable[[], T]) -> tuple[T, float]:
    """What a call returns, and its seconds."""
    began = time.perf_counter()
    result = call()
    return result, time.perf_counter() - began


def cells(rows: Array) -> list[str]:
    """One row of the table: means of durations, mean and worst ratio pair by pair, medians of times, counts of refusals."""
    ratio = rows[:, 0] / rows[:, 1]
    medians = (f"{median * 1e3:.1f}" for median in np.median(rows[:, 2:5], axis=0))
    means = (f"{mean:.2f}" for mean in rows[:, :2].mean(axis=0))
    refusals = (f"{int(count)}" for count in rows[:, 5:].sum(axis=0))
    return [str(len(rows)), *means, f"{ratio.mean():.2f}, {ratio.max():.2f}", *medians, *refusals]


if __name__ == "__main__":
    main()
