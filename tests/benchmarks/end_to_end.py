"""What a client waits for a plan: `python tests/benchmarks/end_to_end.py [--robot panda] [--every 2] [--scenes cage]`.

A planner process and a router on loopback, asked for MotionBenchMaker's problems one after the other with `optimize_s` 0,
or for those of our own making that resemble its other scenes (`support.planner.generated_bench`). The round trip is
wall-clock time from before the request is encoded until the plan is decoded; stages are from the answer. Each is asked
twice in a row and the second time counts: the first one after an edit makes the new scene ready. Needs the problems in
../shared/mbm.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import psutil
from rich.console import Console
from rich.table import Table

sys.path.insert(0, str(Path(__file__).parents[1]))
from support.harness import PATIENCE, ServiceProcess, router
from support.planner import generated_bench, motion_bench
from zarm_contract.errors import ZarmError
from zarm_contract.keys import Keys
from zarm_contract.messages import (
    Goal,
    JointGoal,
    LoadScene,
    PlanRequest,
    PlanTimings,
    PoseGoal,
    SceneEdit,
)
from zarm_geometry.robot_model import RobotModel
from zarm_runtime.bus import Bus

SCENES = (*motion_bench.SCENES, *generated_bench.SCENES)
GENERATED = 30
STAGES = tuple(name for name in PlanTimings.model_fields if name != "total")


def main() -> None:
    """Print one table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--robot", choices=motion_bench.ROBOTS, default="panda")
    parser.add_argument("--every", type=int, default=2, help="take every so-many-th problem")
    parser.add_argument("--scenes", nargs="+", choices=SCENES, default=motion_bench.SCENES)
    parser.add_argument("--goals", nargs="+", choices=("joints", "pose"), default=["joints", "pose"])
    options = parser.parse_args()
    if not motion_bench.AVAILABLE:
        sys.exit(f"there is nothing to measure: MotionBenchMaker's problems are not in {motion_bench.PROBLEMS}")
    table = Table("scene", "goal", "planned", "round trip ms", "outside stages", *(f"{stage} ms" for stage in STAGES))
    everything: list[tuple[float, ...]] = []
    asked = 0
    with tempfile.TemporaryDirectory() as name, router() as endpoint:
        folder = Path(name)
        robot = motion_bench.robot(options.robot, folder)
        keys = Keys(robot.descriptor.name)
        planner = ServiceProcess("planner", endpoint, folder, robot=str(folder / f"{options.robot}.yaml"))
        with Bus(endpoint) as bus, planner:
            planner.wait_ready(bus, keys)
            for scene in options.scenes:
                problems: Sequence[motion_bench.Problem]
                if scene in motion_bench.SCENES:
                    problems = motion_bench.problems(options.robot, scene)
                else:
                    problems = generated_bench.problems(options.robot, RobotModel.of(robot), scene, GENERATED)
                problems = problems[:: options.every]
                for kind in options.goals:
                    rows = [row for problem in problems if (row := run(bus, keys, problem, kind))]
                    table.add_row(scene, kind, *cells(rows, len(problems)))
                    everything += rows
                    asked += len(problems)
            memory = psutil.Process(planner.process.pid).memory_info().rss
    table.add_section()
    table.add_row("all", "", *cells(everything, asked))
    console = Console(width=180)
    console.print(table)
    console.print(f"median / 95th percentile; memory of the planner afterwards {memory / 2**20:.0f} MB")


def run(bus: Bus, keys: Keys, problem: motion_bench.Problem, kind: str) -> tuple[float, ...] | None:
    """Round trip and stages (s) of one problem; None where it is refused."""
    edit = SceneEdit(edit=LoadScene(op="load", objects=problem.objects))
    bus.call(keys.scene_edit, edit, timeout=PATIENCE)
    pose = problem.goal_poses[0]
    goal: Goal = JointGoal(kind="joints", position=problem.goals[0])
    if kind == "pose":
        goal = PoseGoal(kind="pose", position=pose.position, orientation=pose.orientation)
    request = PlanRequest(goal=goal, start=problem.start, optimize_s=0.0)
    try:
        bus.call(keys.plan, request, timeout=PATIENCE)
        began = time.perf_counter()
        timings = bus.call(keys.plan, request, timeout=PATIENCE).timings
    except ZarmError:
        return None
    stages = [getattr(timings, stage) for stage in STAGES]
    whole = time.perf_counter() - began
    return (whole, whole - sum(stages), *stages)


def cells(rows: list[tuple[float, ...]], asked: int) -> list[str]:
    """One row of the table: medians and 95th percentiles in ms."""
    columns = 1e3 * np.array(rows).reshape(-1, 2 + len(STAGES)).T
    return [f"{len(rows)} / {asked}", *(f"{np.median(c):.2f} / {np.percentile(c, 95):.2f}" for c in columns)]


if __name__ == "__main__":
    main()
