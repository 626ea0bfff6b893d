"""What it costs to keep the margin between a robot's own links, and how well it is kept: `python tests/benchmarks/margins.py [--every 2]`.

Each of MotionBenchMaker's problems is planned with no self-margin and with the default, in turn, to its joint goals with a margin of
5 mm to objects. Times are CPU times of one thread, of the whole planning. Needs the problems in ../shared/mbm.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

sys.path.insert(0, str(Path(__file__).parents[1]))
from support.planner import motion_bench
from zarm_contract.errors import ZarmError
from zarm_contract.messages import JointGoal
from zarm_geometry.exact import RESOLUTION, ExactScene
from zarm_geometry.robot_model import RobotModel
from zarm_geometry.world import World
from zarm_planner.context import PlanningContext
from zarm_planner.deadline import Deadline
from zarm_planner.kernels.quintic import followed
from zarm_planner.pipeline import plan
from zarm_planner.planners.registry import AUTO, choose
from zarm_planner.scene.planning_scene import PlanningScene
from zarm_planner.warm_up import warm_up
from zarm_trajectory.limits import Limits

MARGIN = 0.005
SELF_MARGINS = (0.0, 0.005)
FREE_ENDS = 1e-4
"""A motion counts as short of its margin where it is nearer than its own ends by so much (m) more."""


@dataclass(frozen=True)
class Planned:
    """CPU seconds of search with shortcuts, and of everything; duration (s); how far (m) short of the margin two links come, more than at an end."""

    search: float
    total: float
    duration: float
    short: float


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--every", type=int, default=1, help="take every so-many-th problem")
    options = parser.parse_args()
    if not motion_bench.AVAILABLE:
        sys.exit(f"there is nothing to measure: MotionBenchMaker's problems are not in {motion_bench.PROBLEMS}")
    columns = (
        "robot",
        "self-margin",
        "planned",
        "search + shortcut ms",
        "all ms",
        "duration s",
        "short by > 0.1 mm",
        "at worst mm",
    )
    table = Table(*columns)
    with tempfile.TemporaryDirectory() as folder:
        for name in motion_bench.ROBOTS:
            model = RobotModel.of(motion_bench.robot(name, Path(folder)))
            warm_up(model, lambda _: None)
            results: dict[float, list[Planned | None]] = {kept: [] for kept in SELF_MARGINS}
            for scene in motion_bench.SCENES:
                for problem in motion_bench.problems(name, scene)[:: options.every]:
                    for kept, planned in results.items():
                        planned.append(run(model, problem, kept))
            for kept, planned in results.items():
                done = [one for one in planned if one]
                short = np.array([one.short for one in done])
                table.add_row(
                    name,
                    f"{1e3 * kept:.0f} mm",
                    f"{len(done)} / {len(planned)}",
                    median_p95([one.search for one in done]),
                    median_p95([one.total for one in done]),
                    f"{np.mean([one.duration for one in done]):.3f}",
                    str(np.count_nonzero(short > FREE_ENDS)),
                    f"{1e3 * short.max():.2f}",
                )
    Console(width=140).print(table)


def run(model: RobotModel, problem: motion_bench.Problem, self_margin: float) -> Planned | None:
    """One problem; None where there is no plan."""
    world = World(problem.objects, MARGIN)
    scene = PlanningScene("0-000000000000", model, world, ExactScene(model, world)).with_self_margin(self_margin)
    context = PlanningContext(scene, Limits.of(model.robot), Deadline(5.0))
    goal, start = JointGoal(kind="joints", position=problem.goals[0]), np.array(problem.start)
    began = time.thread_time()
    try:
        found = plan(choose(AUTO, goal, constrained=False), context, start, goal)
    except ZarmError as error:
        sys.stderr.write(f"{model.robot.descriptor.name} {problem.index} self-margin {self_margin:g}: {error}\n")
        return None
    total, timings = time.thread_time() - began, context.timer.timings()
    motion = found.trajectory
    _, q = followed(motion.time, motion.position, motion.velocity, motion.acceleration, scene.exact.reach, RESOLUTION)
    wanted = max(SELF_MARGINS)
    ends = {
        near.pair: near.distance
        for end in (q[0], q[-1])
        for near, _ in scene.exact.too_near(end[None], 0.0, 0.0, wanted)
    }
    short = [
        min(kept, ends.get(near.pair, kept)) - near.distance for near, kept in scene.exact.too_near(q, 0.0, 0.0, wanted)
    ]
    return Planned(timings.search + timings.shortcut, total, motion.duration, max(short, default=0.0))


def median_p95(seconds: list[float]) -> str:
    """Median and 95th percentile, in ms."""
    return " / ".join(f"{1e3 * value:.2f}" for value in np.quantile(seconds, (0.5, 0.95)))


if __name__ == "__main__":
    main()
