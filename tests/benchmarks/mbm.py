"""MotionBenchMaker's problems, beside OMPL and, where installed, RoboPlan: `python tests/benchmarks/mbm.py [--seeds 20]`.

All run in turn on each problem, in CPU time of one thread, from Python, after warm-up: on an idle machine the time it takes.
OMPL is driven by zarm's own compiled checks, and shortens with its simplifyMax; RoboPlan (`pip install roboplan==0.7.0`) checks the same spheres itself. Both
take fewer runs. The margin is 0 by default, as in published results on these problems; with one, problems whose start or
goal is not free any more are left out. Needs the problems in ../shared/mbm; plots into docs/images/mbm.png.
"""

from __future__ import annotations

import argparse
import importlib.util
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import matplotlib as mpl
import numpy as np
from rich.console import Console
from rich.table import Table

from zarm_trajectory.arrays import Array

sys.path.insert(0, str(Path(__file__).parents[1]))
from support.planner import motion_bench, ompl_peer
from support.planner.ompl_peer import Run
from zarm_geometry.collision import is_free
from zarm_geometry.exact import ExactScene
from zarm_geometry.robot_model import RobotModel
from zarm_geometry.world import World
from zarm_planner.deadline import Deadline
from zarm_planner.search.rrt_connect import search
from zarm_planner.search.shortcut import shortcut
from zarm_planner.timing.smoothing import smooth_path
from zarm_planner.verification.verify import VerificationFailed, verify
from zarm_planner.warm_up import warm_up
from zarm_trajectory.limits import Limits

mpl.use("Agg")
from matplotlib import pyplot as plt

# The example models, which tests import arms from, install a folder of that name without the planner.
if (
    ROBOPLAN := importlib.util.find_spec("roboplan") is not None
    and importlib.util.find_spec("roboplan.core") is not None
):
    from support.planner import roboplan_peer


TIMEOUT = 1.0
"""Seconds within which a search must be done to count as solved."""
PEERS_TIMEOUT = 5.0
"""What the others get: they look at the wall clock, which runs on while other programs have the processor."""
OMPL_RUNS = 2
ROBOPLAN_EVERY = 4
"""RoboPlan runs once, on every so-many-th problem."""
SLOW = 0.005
"""Seconds of search and shortcut above which a run is told by name."""
PEERS: list[tuple[str, str, Callable[[Result], list[Run | None]]]] = [
    ("OMPL RRTConnect on zarm's checks of edges", "tab:orange", lambda result: result.ompl_edges),
    ("OMPL RRTConnect on zarm's checks of states", "tab:red", lambda result: result.ompl_states),
    ("RoboPlan RRT-Connect", "tab:green", lambda result: result.roboplan),
]
"""Name, colour in the plot, and runs."""
PLOT = Path(__file__).parents[2] / "docs" / "images" / "mbm.png"


@dataclass(frozen=True)
class Motion:
    """What became of a path: CPU seconds of smoothing and of verification, duration (s) and clearance (m, NaN if refused)."""

    smooth: float
    verify: float
    duration: float
    clearance: float


@dataclass(frozen=True)
class Result:
    """All runs of one problem, None where unsolved: zarm's in the order of their seeds; `motion` is that of the first."""

    robot: str
    scene: str
    problem: int
    zarm: list[Run | None]
    motion: Motion | None
    ompl_edges: list[Run | None]
    ompl_states: list[Run | None]
    roboplan: list[Run | None]


def main() -> None:
    """Print the tables and draw the plot."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=20, help="zarm's runs of each problem")
    parser.add_argument("--margin", type=float, default=0.0, help="kept free around the robot (m)")
    parser.add_argument("--every", type=int, default=1, help="take every so-many-th problem")
    options = parser.parse_args()
    if not motion_bench.AVAILABLE:
        sys.exit(f"there is nothing to measure: MotionBenchMaker's problems are not in {motion_bench.PROBLEMS}")
    console = Console(width=175)
    ompl_peer.quiet(seed=1)
    results: list[Result] = []
    with tempfile.TemporaryDirectory() as folder:
        models = {name: RobotModel.of(motion_bench.robot(name, Path(folder))) for name in motion_bench.ROBOTS}
        warm_up(models["panda"], lambda _: None)
        for name, model in models.items():
            for scene in motion_bench.SCENES:
                for problem in motion_bench.problems(name, scene)[:: options.every]:
                    result = run(model, name, scene, problem, options.margin, options.seeds)
                    results += [result] if result else []
    console.print(zarm_table(results))
    for title, _, runs_of in PEERS:
        if any(map(runs_of, results)):
            console.print(peers_table(results, title, runs_of))
    if not ROBOPLAN:
        console.print("RoboPlan is not installed; pip install roboplan==0.7.0 puts it beside")
    console.print(kernels_table(models))
    for line in outliers(results):
        console.print(line)
    draw(results)
    console.print(f"plotted into {PLOT}")


def run(
    model: RobotModel, name: str, scene: str, problem: motion_bench.Problem, margin: float, seeds: int
) -> Result | None:
    """Everybody's runs of one problem; None where the margin rules it out."""
    world = World(problem.objects, margin)
    start, goals = np.array(problem.start), np.array(problem.goals)
    if not all(is_free(model, world, q) for q in (start, *goals)):
        return None
    runs: list[Run | None] = []
    motion = None
    for seed in range(seeds):
        began = time.thread_time()
        path = search(model, world, start, goals, seed=seed, deadline=Deadline(TIMEOUT))
        searched = time.thread_time()
        if path is None:
            runs.append(None)
            continue
        path = shortcut(model, world, path, seed=seed, deadline=Deadline(TIMEOUT))
        runs.append(Run(searched - began, time.thread_time() - searched, length(path)))
        if motion is None:
            motion = timed(model, world, ExactScene(model, world), path)
    edges = [ompl_peer.plan(model, world, start, goals, PEERS_TIMEOUT, edges=True) for _ in range(OMPL_RUNS)]
    states = [ompl_peer.plan(model, world, start, goals, PEERS_TIMEOUT, edges=False)]
    roboplan: list[Run | None] = []
    if ROBOPLAN and problem.index % ROBOPLAN_EVERY == 0:
        peer = roboplan_peer.scene(model, problem.objects)
        roboplan = [roboplan_peer.plan(peer, model, start, goals[0], PEERS_TIMEOUT, seed=0)]
    return Result(name, scene, problem.index, runs, motion, edges, states, roboplan)


def timed(model: RobotModel, world: World, exact: ExactScene, path: Array) -> Motion:
    """Smooth a path and verify the motion."""
    limits, began = Limits.of(model.robot), time.thread_time()
    motion = smooth_path(model, world, path, limits, 0.01, seed=0, deadline=Deadline(60.0))
    smoothed = time.thread_time()
    try:
        clearance = verify(motion, path[0], path[-1], limits, exact, lambda: None)
    except VerificationFailed:
        clearance = float("nan")
    return Motion(smoothed - began, time.thread_time() - smoothed, motion.duration, clearance)


def by_scene(results: list[Result]) -> dict[tuple[str, str], list[Result]]:
    """The results of each robot and scene, and at last all of them."""
    groups: dict[tuple[str, str], list[Result]] = {}
    for result in results:
        groups.setdefault((result.robot, result.scene), []).append(result)
    return groups | {("all", ""): results}


def zarm_table(results: list[Result]) -> Table:
    """Solved, times per stage (median / 95th percentile), and means of what came out."""
    stages = ("search ms", "shortcut ms", "together ms", "smooth ms", "verify ms")
    table = Table(
        "robot", "scene", "solved", *stages, "length rad", "duration s", "clearance mm", "refused", title="zarm"
    )
    for names, group in by_scene(results).items():
        runs = [run for result in group for run in result.zarm]
        solved = [run for run in runs if run]
        motions = [result.motion for result in group if result.motion]
        clearances = np.array([motion.clearance for motion in motions])
        table.add_row(
            *names,
            f"{len(solved)} / {len(runs)}",
            median_p95([run.search for run in solved]),
            median_p95([run.shortcut for run in solved]),
            median_p95([run.search + run.shortcut for run in solved]),
            median_p95([motion.smooth for motion in motions]),
            median_p95([motion.verify for motion in motions]),
            f"{np.mean([run.length for run in solved]):.2f}",
            f"{np.mean([motion.duration for motion in motions]):.2f}",
            f"{1e3 * np.nanmean(clearances):.1f}",
            str(np.isnan(clearances).sum()),
            end_section=names == list(by_scene(results))[-2],
        )
    return table


def peers_table(results: list[Result], title: str, runs_of: Callable[[Result], list[Run | None]]) -> Table:
    """A peer's figures, and how many times as long it takes: the median over problems of its median by zarm's."""
    columns = ("robot", "scene", "solved", "search ms", "shortcut ms", "together ms", "length rad")
    table = Table(*columns, "x search", "x together", "x length", title=title)
    for names, group in by_scene(results).items():
        runs = [run for result in group for run in runs_of(result)]
        solved = [run for run in runs if run]
        pairs = [
            (peer, zarm)
            for result in group
            if (peer := [run for run in runs_of(result) if run]) and (zarm := [run for run in result.zarm if run])
        ]
        ratios = [
            float(np.median([np.median(list(map(of, peer))) / np.median(list(map(of, zarm))) for peer, zarm in pairs]))
            for of in (lambda run: run.search, lambda run: run.search + run.shortcut, lambda run: run.length)
        ]
        table.add_row(
            *names,
            f"{len(solved)} / {len(runs)}",
            median_p95([run.search for run in solved]),
            median_p95([run.shortcut for run in solved]),
            median_p95([run.search + run.shortcut for run in solved]),
            f"{np.mean([run.length for run in solved]):.2f}",
            f"{ratios[0]:.1f}",
            f"{ratios[1]:.1f}",
            f"{ratios[2]:.2f}",
            end_section=names == list(by_scene(results))[-2],
        )
    return table


def outliers(results: list[Result]) -> Iterator[str]:
    """Every run of zarm that found nothing in time or was slow."""
    for result in results:
        for seed, run in enumerate(result.zarm):
            name = f"{result.robot} {result.scene} problem {result.problem} seed {seed}"
            if run is None:
                yield f"{name}: not solved within {TIMEOUT:g} s"
            elif run.search + run.shortcut > SLOW:
                yield f"{name}: search {1e3 * run.search:.1f} ms, shortcut {1e3 * run.shortcut:.1f} ms"


def kernels_table(models: dict[str, RobotModel]) -> Table:
    """Microseconds per check; many are done in one call, so the way through Python hardly counts."""
    table = Table("robot", "configuration us", "free edge of 1 rad us", title="collision checks in the first box scene")
    for name, model in models.items():
        problem = motion_bench.problems(name, "box")[0]
        world, rng, start = World(problem.objects, 0.0), np.random.default_rng(0), np.array(problem.start)
        steps = rng.normal(size=(2000, model.dof))
        ends = np.clip(start + steps / np.linalg.norm(steps, axis=1, keepdims=True), model.lower, model.upper)
        free = [end for end in ends if is_free(model, world, np.array((start, end)))]
        paths = (np.repeat(start[None], 2000, axis=0), np.array([q for end in free for q in (start, end)]))
        times = []
        for path in paths:
            rounds = []
            for _ in range(5):
                began = time.thread_time()
                is_free(model, world, path)
                rounds.append(time.thread_time() - began)
            times.append(f"{1e6 * min(rounds) / len(path):.2f}")
        table.add_row(name, *times)
    return table


def draw(results: list[Result]) -> None:
    """The part of all runs that is done after so much time."""
    figure, axes = plt.subplots(figsize=(7.5, 4.5))
    for name, color, runs_of in [("zarm", "tab:blue", lambda result: result.zarm), *PEERS]:
        runs = [run for result in results for run in runs_of(result)]
        for style, stage, of in (
            (":", "search", lambda run: run.search),
            ("-", "search and shortcut", lambda run: run.search + run.shortcut),
        ):
            times = np.sort([1e3 * of(run) for run in runs if run])
            if len(times):
                part = 100.0 * np.arange(1, len(times) + 1) / len(runs)
                axes.step(times, part, style, where="post", color=color, label=f"{name}: {stage}")
    axes.set(xscale="log", xlabel="CPU time of one thread (ms)", ylabel="solved (%)", ylim=(0, 101))
    axes.set_title(f"MotionBenchMaker, {len(results)} problems: solved after so much time")
    axes.grid(alpha=0.3)
    axes.legend(fontsize="small", loc="upper center", bbox_to_anchor=(0.5, -0.14), ncols=2)
    PLOT.parent.mkdir(exist_ok=True)
    figure.savefig(PLOT, dpi=120, bbox_inches="tight")


def median_p95(seconds: list[float]) -> str:
    """Both in ms."""
    return f"{1e3 * np.median(seconds):.2f} / {1e3 * np.percentile(seconds, 95):.2f}" if seconds else "-"


def length(path: Array) -> float:
    """Euclidean, rad."""
    return float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum())


if __name__ == "__main__":
    main()
