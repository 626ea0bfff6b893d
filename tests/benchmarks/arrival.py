"""How soon motions arrive on MotionBenchMaker's problems: `python tests/benchmarks/arrival.py [--every 2] [--margin 0.0]`.

The same shortened path is timed twice under the same limits of velocity and acceleration: by zarm, which holds the limit of
jerk besides, and the usual way, which does not: TOPPRA along a cubic spline through the path, made dense to 0.1 rad. Then
zarm goes on looking for faster motions, each verified on exact geometry, for up to 0.5 s. One thread, seconds of its own
processor time, from Python, after warm-up; needs the problems in ../shared/mbm.
"""

from __future__ import annotations

import argparse
import itertools
import logging
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import matplotlib
import numpy as np
from rich.console import Console
from rich.table import Table
from toppra import SplineInterpolator
from toppra.algorithm import TOPPRA
from toppra.constraint import JointAccelerationConstraint, JointVelocityConstraint

from zarm_trajectory.arrays import Array

sys.path.insert(0, str(Path(__file__).parents[1]))
from support.planner import motion_bench
from zarm_geometry.collision import is_free
from zarm_geometry.exact import ExactScene
from zarm_geometry.robot_model import RobotModel
from zarm_geometry.world import World
from zarm_planner.deadline import Deadline
from zarm_planner.search.rrt_connect import search
from zarm_planner.search.shortcut import shortcut
from zarm_planner.timing.improvement import Improvement
from zarm_planner.timing.smoothing import smooth_path
from zarm_planner.timing.time_parameterization import time_path
from zarm_planner.verification.verify import VerificationFailed, verify
from zarm_planner.warm_up import warm_up
from zarm_trajectory.limits import Limits
from zarm_trajectory.trajectory import TimedTrajectory

matplotlib.use("Agg")
from matplotlib import pyplot

T = TypeVar("T")

DT = 0.01
DENSE = 0.1
BUDGETS = (0.0, 0.02, 0.1, 0.5)
PLOT = Path(__file__).parents[2] / "docs" / "images" / "arrival.png"
ENDLESS = Deadline(1e6)
COLUMNS = (
    "robot", "scene", "paths", "zarm s", "TOPPRA s", "ratio, worst", *(f"+{budget:g} s" for budget in BUDGETS[1:]), "least",
    "zarm ms", "TOPPRA ms", "verify ms", "refused: zarm", "TOPPRA", "longer",
)  # fmt: skip


class Processor(Deadline):
    """A budget of `seconds` of this thread on the processor."""

    def __init__(self, seconds: float) -> None:
        super().__init__(1e6)
        self._end = time.thread_time() + seconds

    @property
    def passed(self) -> bool:
        """Whether they are used up."""
        return time.thread_time() > self._end


@dataclass(frozen=True)
class Run:
    """One path: durations of motions (s), zarm's after each of BUDGETS; seconds to compute; and what was refused.

    `least` is the time in which the slowest joint gets from its start to its goal without jerk limit and obstacles.
    """

    zarm: tuple[float, ...]
    toppra: float
    least: float
    zarm_seconds: float
    toppra_seconds: float
    verify_seconds: float
    zarm_refused: bool
    toppra_refused: bool


def main() -> None:
    """Print one table, and plot it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--every", type=int, default=2, help="take every so-many-th problem")
    parser.add_argument("--margin", type=float, default=0.0, help="kept free around the robot (m)")
    options = parser.parse_args()
    if not motion_bench.AVAILABLE:
        sys.exit(f"there is nothing to measure: MotionBenchMaker's problems are not in {motion_bench.PROBLEMS}")
    logging.getLogger("toppra").setLevel(logging.CRITICAL)
    with tempfile.TemporaryDirectory() as folder:
        models = {name: RobotModel.of(motion_bench.robot(name, Path(folder))) for name in motion_bench.ROBOTS}
    warm_up(models["panda"], lambda _: None)
    table = Table(*COLUMNS)
    everything: list[Run] = []
    for name, model in models.items():
        for scene in motion_bench.SCENES:
            found = [
                run(model, problem, options.margin) for problem in motion_bench.problems(name, scene)[:: options.every]
            ]
            runs = [one for one in found if one is not None]
            if runs:
                table.add_row(name, scene, *cells(runs))
            everything += runs
    table.add_section()
    table.add_row("all", "", *cells(everything))
    if refused := [one for one in everything if one.toppra_refused]:
        table.add_row("TOPPRA refused", "", *cells(refused))
    Console(width=180).print(table)
    plot(everything)


def run(model: RobotModel, problem: motion_bench.Problem, margin: float) -> Run | None:
    """One problem; None where the margin rules it out."""
    world, limits = World(problem.objects, margin), Limits.of(model.robot)
    scene = ExactScene(model, world)
    start, goals = np.array(problem.start), np.array(problem.goals)
    if not all(is_free(model, world, end) for end in (start, *goals)):
        return None

    def route(seed: int) -> tuple[Array, tuple[int, ...]] | None:
        path = search(model, world, start, goals, seed=seed, deadline=ENDLESS, most=10_000)
        return None if path is None else (shortcut(model, world, path, seed=seed, deadline=ENDLESS), ())

    if (found := route(0)) is None:
        return None
    path, _ = found

    def refused(motion: TimedTrajectory) -> bool:
        try:
            verify(motion, path[0], path[-1], limits, scene, lambda: None)
        except VerificationFailed:
            return True
        return False

    usual, toppra_seconds = timed(lambda: toppra(path, limits))
    first, zarm_seconds = timed(lambda: smooth_path(model, world, path, limits, DT, seed=0, deadline=ENDLESS))
    first_refused, verify_seconds = timed(lambda: refused(first))
    if first_refused:  # as the planner does then
        first = next(
            motion for motion in (time_path(path, limits, DT, d) for d in (0.03, 0.01, 0.0)) if not refused(motion)
        )
    best = [first.duration]
    improvement = Improvement(model, world, limits, DT, route, seed=0)
    for spent, budget in itertools.pairwise(BUDGETS):
        shortest, stop = best[-1], Processor(budget - spent)
        while (motion := improvement.faster_than(shortest, stop)) is not None:
            if not refused(motion):
                shortest = motion.duration
        best.append(shortest)
    way = np.abs(path[-1] - path[0])
    steady = way / limits.velocity + limits.velocity / limits.acceleration
    least = np.where(way < limits.velocity**2 / limits.acceleration, 2 * np.sqrt(way / limits.acceleration), steady)
    return Run(
        tuple(best), usual.duration, float(least.max()), zarm_seconds, toppra_seconds, verify_seconds, first_refused,
        scene.nearest(usual.position, lambda: None).distance <= 0.0,
    )  # fmt: skip


def toppra(path: Array, limits: Limits) -> TimedTrajectory:
    """TOPPRA along a cubic spline through the path, made dense; sampled every few milliseconds."""
    rows = [path[:1]]
    for a, b in itertools.pairwise(path):
        pieces = max(1, int(np.ceil(np.linalg.norm(b - a) / DENSE)))
        rows.append(a + (b - a) * np.arange(1, pieces + 1)[:, None] / pieces)
    dense = np.concatenate(rows)
    along = np.insert(np.cumsum(np.linalg.norm(np.diff(dense, axis=0), axis=1)), 0, 0.0)
    constraints = [JointVelocityConstraint(limits.velocity), JointAccelerationConstraint(limits.acceleration)]
    spline = SplineInterpolator(along, dense)
    trajectory = TOPPRA(constraints, spline, parametrizer="ParametrizeConstAccel").compute_trajectory(0.0, 0.0)
    t = np.linspace(0.0, trajectory.duration, 2 + int(trajectory.duration / 0.002))
    return TimedTrajectory(t, trajectory(t), trajectory(t, 1), trajectory(t, 2))


def timed(call: Callable[[], T]) -> tuple[T, float]:
    """What a call returns, and its seconds of processor time."""
    began = time.thread_time()
    result = call()
    return result, time.thread_time() - began


def cells(runs: list[Run]) -> list[str]:
    """One row of the table: means of durations, mean and worst ratio pair by pair, medians of times, counts."""
    toppra = np.array([one.toppra for one in runs])
    zarm = np.array([one.zarm for one in runs])
    ratio = zarm / toppra[:, None]
    seconds = np.median([(one.zarm_seconds, one.toppra_seconds, one.verify_seconds) for one in runs], axis=0)
    return [
        str(len(runs)),
        f"{zarm[:, 0].mean():.2f}",
        f"{toppra.mean():.2f}",
        f"{ratio[:, 0].mean():.3f}, {ratio[:, 0].max():.2f}",
        *(f"{mean:.3f}" for mean in ratio[:, 1:].mean(axis=0)),
        f"{np.mean([one.least for one in runs] / toppra):.3f}",
        *(f"{median * 1e3:.1f}" for median in seconds),
        str(sum(one.zarm_refused for one in runs)),
        str(sum(one.toppra_refused for one in runs)),
        " ".join(str(int(count)) for count in (ratio > 1.0).sum(axis=0)),
    ]


def plot(runs: list[Run]) -> None:
    """How the ratios are spread, for each budget."""
    figure, axes = pyplot.subplots(figsize=(8, 5), layout="constrained")
    share = (np.arange(len(runs)) + 1) / len(runs)
    for k, budget in enumerate(BUDGETS):
        ratio = np.sort([one.zarm[k] / one.toppra for one in runs])
        axes.step(ratio, share, where="post", label=f"optimised for {budget:g} s: mean {ratio.mean():.3f}")
    least = np.sort([one.least / one.toppra for one in runs])
    axes.step(least, share, color="grey", linestyle=":", label=f"no obstacles, no jerk limit: mean {least.mean():.3f}")
    axes.axvline(1.0, color="black", linewidth=0.8)
    axes.set(
        title="Duration of verified, jerk-limited motions over that of shortcut + TOPPRA",
        xlabel="ratio, problem by problem",
        ylabel="share of MotionBenchMaker's problems",
    )
    axes.legend()
    axes.grid(alpha=0.3)
    PLOT.parent.mkdir(exist_ok=True)
    figure.savefig(PLOT, dpi=120)


if __name__ == "__main__":
    main()
