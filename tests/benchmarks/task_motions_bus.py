"""What a client waits for lines, arcs, seams and programs: `python tests/benchmarks/task_motions_bus.py [--rounds 60]`.

A planner process and a router on loopback; the round trip is wall-clock time from before the request is encoded until the plan is decoded. Each
motion is asked in turn, each time from another height, so that no answer is known before. The scene is a table and a post.
"""

from __future__ import annotations

import argparse
import math
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

sys.path.insert(0, str(Path(__file__).parents[1]))
from support.harness import PATIENCE, ServiceProcess, router
from zarm_contract.keys import Keys
from zarm_contract.messages import (
    AddObjects,
    ArcGoal,
    Cuboid,
    Goal,
    IkRequest,
    LineGoal,
    Move,
    PathGoal,
    PathPoint,
    Plan,
    PlanRequest,
    Pose,
    PoseGoal,
    ProgramRequest,
    SceneEdit,
)
from zarm_contract.robot import load_robot
from zarm_runtime.bus import Bus

DOWN = (1.0, 0.0, 0.0, 0.0)
ABOUT_TOOL = (0.0, 0.0, "free")
X, Y, Z = 0.5, 0.25, 0.45
"""m; half of the work is to each side of the robot."""
HEIGHTS = 0.1
"""m; motions begin at heights that differ by up to this."""


def line(z: float) -> PlanRequest:
    return PlanRequest(goal=LineGoal(kind="line", position=(X, Y, z), speed=0.25))


def arc(z: float) -> PlanRequest:
    return PlanRequest(goal=ArcGoal(kind="arc", position=(X, Y, z), via=(X + 0.25, 0.0, z), speed=0.25))


def seam(z: float) -> PlanRequest:
    along = np.linspace(-Y, Y, 200)
    points = tuple(PathPoint(position=(X + 0.03 * math.sin(12.0 * y), y, z)) for y in along[1:].tolist())
    goal = PathGoal(kind="path", points=points, shape="spline", speed=0.1, orientation_tolerance=ABOUT_TOOL)
    return PlanRequest(goal=goal)


def program(z: float) -> ProgramRequest:
    goals: list[Goal] = []
    for k in range(10):
        y = -Y + 2 * Y * (k + 1) / 10
        goals.append(PoseGoal(kind="pose", position=(X, y, z + 0.1), orientation=DOWN))
        goals.append(LineGoal(kind="line", position=(X, y, z), speed=0.25))
    return ProgramRequest(segments=tuple(Move(kind="move", goal=goal) for goal in goals))


MOTIONS: dict[str, Callable[[float], PlanRequest | ProgramRequest]] = {
    "line of 0.5 m": line,
    "arc of 0.25 m radius": arc,
    "seam of 200 points, tool turns freely": seam,
    "program of 20 segments": program,
}


def main() -> None:
    """Print one table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--robot", default="doosan_m1013")
    parser.add_argument("--rounds", type=int, default=60)
    options = parser.parse_args()
    robot = load_robot(options.robot)
    keys = Keys(robot.descriptor.name)
    took: dict[str, list[tuple[float, float]]] = {name: [] for name in MOTIONS}
    random = np.random.default_rng(0)
    with tempfile.TemporaryDirectory() as name, router() as endpoint:
        planner = ServiceProcess("planner", endpoint, Path(name), robot=options.robot)
        with Bus(endpoint) as bus, planner:
            planner.wait_ready(bus, keys)
            objects = (
                Cuboid(kind="cuboid", name="table", size=(0.6, 1.2, 0.05), position=(X + 0.1, 0.0, 0.1)),
                Cuboid(kind="cuboid", name="post", size=(0.1, 0.1, 0.5), position=(X + 0.4, 0.5, 0.4)),
            )
            bus.call(keys.scene_edit, SceneEdit(edit=AddObjects(op="add", objects=objects)), timeout=PATIENCE)
            for round_ in range(options.rounds + 1):
                z = Z + float(random.uniform(0.0, HEIGHTS))
                start = start_at(bus, keys, z)
                for name, made in MOTIONS.items():
                    request = made(z).model_copy(update={"start": start})
                    began = time.perf_counter()
                    if isinstance(request, ProgramRequest):
                        plan: Plan = bus.call(keys.program, request, timeout=PATIENCE)
                    else:
                        plan = bus.call(keys.plan, request, timeout=PATIENCE)
                    if round_:
                        took[name].append((time.perf_counter() - began, plan.timings.total))
    table = Table("motion", "round trip ms, median", "p95", "planner ms, median")
    for name, rows in took.items():
        trips, inside = 1e3 * np.array(rows).T
        table.add_row(name, f"{np.median(trips):.1f}", f"{np.percentile(trips, 95):.1f}", f"{np.median(inside):.1f}")
    Console(width=120).print(table)


def start_at(bus: Bus, keys: Keys, z: float) -> tuple[float, ...]:
    """Joints (rad) in which the tip points down at a height (m), at the beginning of each motion."""
    pose = Pose(position=(X, -Y, z), orientation=DOWN)
    return bus.call(keys.ik, IkRequest(poses=(pose,)), timeout=PATIENCE).solutions[0][0]


if __name__ == "__main__":
    main()
