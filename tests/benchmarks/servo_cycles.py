"""Cycles of a session beside a planner that is never idle: `python tests/benchmarks/servo_cycles.py [--seconds 30]`.

Router, planner, executor and servo as processes. One client keeps the planner at work, another jogs the robot to and fro beside a wall, with a
target every 20 ms. The servo itself counts its cycles, how many began more than 2 ms late, and how long they took.
"""

from __future__ import annotations

import argparse
import itertools
import sys
import tempfile
import threading
import time
from contextlib import ExitStack, suppress
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

sys.path.insert(0, str(Path(__file__).parents[1]))
import zarm
from support.harness import ServiceProcess, router
from support.planner.client import load
from support.trajectories import HOME, KEYS, ROBOT
from zarm.servoing import PERIOD
from zarm_contract.errors import ZarmError
from zarm_contract.messages import Cuboid, JointGoal, PlanRequest
from zarm_geometry.robot_model import RobotModel
from zarm_runtime.bus import Bus

SWING = 1.0
"""Seconds from one end of the jogging to the other."""


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--seconds",
        type=float,
        default=30.0,
        help="how long to jog beside an idle planner, and again beside a busy one",
    )
    seconds = parser.parse_args().seconds
    table = Table("planner", "cycles", "late by > 2 ms", "computing p99, median of the session", "worst", "plans")
    with tempfile.TemporaryDirectory() as folder, ExitStack() as stack:
        endpoint = stack.enter_context(router())
        bus = stack.enter_context(Bus(endpoint))
        services = ("planner", "leeloo_sim", "executor", "servo")
        processes = [stack.enter_context(ServiceProcess(service, endpoint, Path(folder))) for service in services]
        for process in processes:
            process.wait_ready(bus, KEYS)
        x = float(RobotModel.of(ROBOT).fk_tip(HOME)[0, 3]) + 0.2
        load(bus, Cuboid(kind="cuboid", name="wall", position=(x, 0.0, 0.5), size=(0.1, 4.0, 3.0)))
        robot = stack.enter_context(zarm.connect(endpoint))
        for busy in (False, True):
            planned, over = [0], threading.Event()
            asking = threading.Thread(target=ask, args=(bus, planned, over))
            if busy:
                asking.start()
            computing, cycles, late = jog(robot, seconds)
            over.set()
            if busy:
                asking.join()
            table.add_row(
                "busy" if busy else "idle",
                str(cycles),
                f"{late} ({100 * late / max(cycles, 1):.2f} %)",
                f"{1e3 * np.median(computing):.2f} ms",
                f"{1e3 * np.max(computing):.2f} ms",
                str(planned[0]),
            )
    Console(width=120).print(table)


def jog(robot: zarm.Robot, seconds: float) -> tuple[list[float], int, int]:
    """Jog to and fro; the p99 of computing (s) whenever the servo told it, the cycles, and how many were late."""
    computing = []
    with robot.jog() as jogging:
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            way = 1.0 if int(time.monotonic() / SWING) % 2 else -1.0
            jogging.twist((0.05, 0.1 * way, 0.0))
            if jogging.state is not None and jogging.state.cycles > 100:
                computing.append(jogging.state.computing)
            time.sleep(PERIOD)
        state = jogging.state
    return computing, 0 if state is None else state.cycles, 0 if state is None else state.late_cycles


def ask(bus: Bus, planned: list[int], over: threading.Event) -> None:
    """Keep the planner at work."""
    for seed in itertools.count():
        if over.is_set():
            return
        goal = JointGoal(kind="joints", position=(1.5 if seed % 2 else -1.5, *HOME[1:].tolist()))
        with suppress(ZarmError):
            request = PlanRequest(goal=goal, start=tuple(HOME.tolist()), seed=seed, optimize_s=0.2)
            bus.call(KEYS.plan, request, timeout=10.0)
            planned[0] += 1


if __name__ == "__main__":
    main()
