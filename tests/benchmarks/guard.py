"""From the answer to an edit that blocks the way to the beginning of braking: planner, executor and servo as processes.

    python tests/benchmarks/guard.py [EDITS] [OBJECTS]

Beside OBJECTS in the scene, a ball is put where the tip of a moving robot is, so that it must brake at once, and is taken away again,
EDITS times. Braking begins when the goal is first published as held. A negative time means that the robot brakes before the client knows that
the edit is done: its publication comes before its answer.
"""

from __future__ import annotations

import sys
import tempfile
import threading
import time
from contextlib import ExitStack
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

from support.executor.client import Client
from support.harness import ServiceProcess, router
from support.planner.client import BEHIND_POST, HOME, load, plan, to_joints
from support.planner.second_opinion import link_pose
from support.trajectories import KEYS, ROBOT, with_execution
from zarm_contract.messages import (
    AddObjects,
    Cuboid,
    GoalState,
    PlanRequest,
    RemoveObjects,
    SceneEdit,
    Sphere,
)
from zarm_runtime.bus import Bus


def crowd(count: int) -> list[Cuboid]:
    """Small boxes out of the way, behind the robot."""
    random = np.random.default_rng(1)
    return [
        Cuboid(
            kind="cuboid",
            name=f"box{index}",
            position=(float(random.uniform(-3, -2)), float(random.uniform(-1, 1)), float(random.uniform(0, 2))),
            size=(0.02, 0.02, 0.02),
        )
        for index in range(count)
    ]


def main(edits: int = 40, objects: int = 100) -> None:
    """Print the percentiles."""
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        endpoint = stack.enter_context(router())
        bus = stack.enter_context(Bus(endpoint))
        robot = str(with_execution(folder / "robot", "guard_timeout: 2.0"))
        for service in ("planner", "servo", "executor"):
            process = stack.enter_context(ServiceProcess(service, endpoint, folder, robot))
            process.wait_ready(bus, KEYS)
        client = Client(bus)
        held, free = threading.Event(), threading.Event()
        held_at = [0.0]

        def watch(_key: str, goal: GoalState) -> None:
            if goal.hold is not None and not held.is_set():
                held_at[0] = time.perf_counter()
                held.set()
            elif goal.hold is None:
                free.set()

        bus.subscribe(KEYS.goal("*"), watch)
        load(bus, *crowd(objects))
        delays, there = [], False
        while len(delays) < edits:
            there = not there
            made = plan(bus, PlanRequest(goal=to_joints(*(BEHIND_POST if there else HOME)), velocity_scale=0.2))
            goal = client.execute(plan_id=made.plan_id)
            client.under_way(goal, 0.05)
            for _ in range(4):
                if client.goal(goal).progress > 0.3:
                    break
                time.sleep(0.2)
                held.clear()
                tip = link_pose(ROBOT, ROBOT.descriptor.tip_link, client.measured[-1].position)[:3, 3].tolist()
                ball = Sphere(kind="sphere", name="ball", position=tuple(tip), radius=0.05)
                add = SceneEdit(edit=AddObjects(op="add", objects=(ball,)))
                bus.call(KEYS.scene_edit, add, timeout=10)
                answered = time.perf_counter()
                if held.wait(0.5):
                    delays.append(held_at[0] - answered)
                free.clear()
                bus.call(
                    KEYS.scene_edit,
                    SceneEdit(edit=RemoveObjects(op="remove", names=("ball",))),
                    timeout=10,
                )
                free.wait(2.0)
            client.ended(goal)
    share = np.percentile(np.array(delays) * 1e3, (50, 95, 99, 100))
    sys.stdout.write(
        f"from the answer to braking, {len(delays)} edits beside {objects} objects: "
        f"median {share[0]:.1f} ms, p95 {share[1]:.1f} ms, p99 {share[2]:.1f} ms, longest {share[3]:.1f} ms\n"
    )


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
