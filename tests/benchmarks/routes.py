"""How short the planner's motions are: `python tests/benchmarks/routes.py [--every 4] [--optimize 0.0] [--seeds 1]`.

All stages, to joints, on MotionBenchMaker's problems and on those of our own making that resemble its other scenes
(`support.planner.generated_bench`). The reference is another planner's route, OMPL's RRTConnect with simplifyMax, timed the usual way:
TOPPRA along a cubic spline through it, without a jerk limit; the median of three. "Route" is the planner's path over the shortest
of ten seeds'. CPU time of one thread, after warm-up; needs the problems in ../shared/mbm.
"""

from __future__ import annotations

import argparse
import logging
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import arrival
import numpy as np
from rich.console import Console
from rich.table import Table

sys.path.insert(0, str(Path(__file__).parents[1]))
from support.planner import generated_bench, motion_bench, ompl_peer
from support.planner.motion_bench import Problem
from zarm_contract.errors import ZarmError
from zarm_contract.messages import JointGoal
from zarm_geometry.exact import ExactScene
from zarm_geometry.robot_model import RobotModel
from zarm_geometry.world import World
from zarm_planner.context import PlanningContext
from zarm_planner.deadline import Deadline
from zarm_planner.pipeline import plan
from zarm_planner.planners.registry import AUTO, choose
from zarm_planner.scene.planning_scene import PlanningScene
from zarm_planner.search.rrt_connect import search
from zarm_planner.search.shortcut import shortcut
from zarm_planner.warm_up import warm_up
from zarm_trajectory.limits import Limits

REFERENCES = 3
BEST_OF = 10
SAMPLES = 100_000
TIMEOUT = 5.0


@dataclass(frozen=True)
class Run:
    """A plan: duration (s), that over the reference's, its length over the shortest route's, and CPU seconds."""

    duration: float
    ratio: float
    route: float
    seconds: float


def main() -> None:
    """Print one table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--every", type=int, default=4, help="take every so-many-th problem")
    parser.add_argument("--optimize", type=float, default=0.0, help="optimize_s")
    parser.add_argument("--seeds", type=int, default=1, help="plans of each problem")
    options = parser.parse_args()
    if not motion_bench.AVAILABLE:
        sys.exit(f"there is nothing to measure: MotionBenchMaker's problems are not in {motion_bench.PROBLEMS}")
    logging.getLogger("toppra").setLevel(logging.CRITICAL)
    ompl_peer.quiet(seed=1)
    table = Table("robot", "scene", "planned", "duration s", "ratio", "> 1", "> 1.02", "worst", "route", "CPU ms, p95")
    everything: list[Run | None] = []
    with tempfile.TemporaryDirectory() as folder:
        for name in motion_bench.ROBOTS:
            model = RobotModel.of(motion_bench.robot(name, Path(folder)))
            warm_up(model, lambda _: None)
            scenes = {scene: motion_bench.problems(name, scene) for scene in motion_bench.SCENES}
            scenes |= {scene: generated_bench.problems(name, model, scene, 30) for scene in generated_bench.SCENES}
            for scene, problems in scenes.items():
                runs = [
                    one
                    for problem in problems[:: options.every]
                    for one in planned(model, problem, options.seeds, options.optimize)
                ]
                table.add_row(name, scene, *cells(runs))
                everything += runs
    table.add_section()
    table.add_row("all", "", *cells(everything))
    Console(width=140).print(table)


def planned(model: RobotModel, problem: Problem, seeds: int, optimize: float) -> list[Run | None]:
    """One problem with several seeds; None where there was no plan."""
    world, limits = World(problem.objects, 0.0), Limits.of(model.robot)
    start, goals = np.array(problem.start), np.array(problem.goals)
    paths = [ompl_peer.simplified(model, world, start, goals, TIMEOUT) for _ in range(REFERENCES)]
    found = [path for path in paths if path is not None]
    reference = float(np.median([arrival.toppra(path, limits).duration for path in found])) if found else np.nan
    routes = [
        length(shortcut(model, world, path, seed=seed, deadline=arrival.ENDLESS))
        for seed in range(BEST_OF)
        if (path := search(model, world, start, goals, seed=seed, deadline=Deadline(TIMEOUT), most=SAMPLES)) is not None
    ]
    shortest = min(routes, default=np.nan)
    scene = PlanningScene("0-000000000000", model, world, ExactScene(model, world))
    goal, runs = JointGoal(kind="joints", position=problem.goals[0]), list[Run | None]()
    for seed in range(seeds):
        context = PlanningContext(scene, limits, Deadline(TIMEOUT), optimize_s=optimize, seed=seed)
        began = time.thread_time()
        try:
            motion = plan(choose(AUTO, goal, constrained=False), context, start, goal).trajectory
        except ZarmError as error:
            sys.stderr.write(f"{model.robot.descriptor.name} {problem.index} seed {seed}: {error}\n")
            runs.append(None)
            continue
        seconds = time.thread_time() - began
        runs.append(Run(motion.duration, motion.duration / reference, motion.length / shortest, seconds))
    return runs


def length(path: arrival.Array) -> float:
    """Euclidean, rad."""
    return float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum())


def cells(runs: Sequence[Run | None]) -> list[str]:
    """One row of the table."""
    done = [one for one in runs if one]
    ratio, seconds = np.array([one.ratio for one in done]), [one.seconds for one in done]
    return [
        f"{len(done)} / {len(runs)}",
        f"{np.mean([one.duration for one in done]):.2f}",
        f"{np.nanmean(ratio):.3f}",
        str(np.count_nonzero(ratio > 1.0)),
        str(np.count_nonzero(ratio > 1.02)),
        f"{np.nanmax(ratio):.2f}",
        f"{np.nanmean([one.route for one in done]):.3f}",
        " / ".join(f"{1e3 * value:.1f}" for value in np.quantile(seconds, (0.5, 0.95))),
    ]


if __name__ == "__main__":
    main()
