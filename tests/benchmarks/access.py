"""What certificates and access control cost: `python tests/benchmarks/access.py [--plans 100] [--commands 1000]`.

Two routers, each a process, one with ZARM_SECURITY on and one without, and a planner on each; requests and messages go to
both by turns. A plan's round trip is from before the request is encoded until the plan is decoded; a command's way is from
before an executor's session publishes it (express, real-time priority) until another session has it, through the router.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import threading
import time
from contextlib import ExitStack
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

sys.path.insert(0, str(Path(__file__).parents[1]))
from support.command_line import KEYS, Router, zarm
from support.harness import PATIENCE, ServiceProcess, free_endpoint
from support.planner.client import BEHIND_POST, HOME, POST, TABLE, load
from zarm_contract.messages import DriverCommand, JointGoal, PlanRequest
from zarm_runtime.bus import Bus

POINTS = 8
"""In a command, about as many as `joint_speed` sends at once."""


class Side:
    """One bus: round trips, what of them is outside the planner's own stages, and ways, s."""

    def __init__(self, settings: dict[str, str], folder: Path, stack: ExitStack) -> None:
        self.plans: list[float] = []
        self.outside: list[float] = []
        self.commands: list[float] = []
        self._arrived = threading.Event()
        os.environ.update(settings)
        endpoint = free_endpoint()
        stack.enter_context(Router(folder, "--listen", endpoint, **settings))
        planner = stack.enter_context(ServiceProcess("planner", endpoint, folder))
        self._operator = stack.enter_context(Bus(endpoint, role="operator"))
        executor = stack.enter_context(Bus(endpoint, role="executor"))
        driver = stack.enter_context(Bus(endpoint, role="driver"))
        planner.wait_ready(self._operator, KEYS)
        load(self._operator, TABLE, POST)
        driver.listen(KEYS.driver_command, lambda _key, _payload: self._arrived.set())
        self._publisher = executor.publisher(KEYS.driver_command)

    def plan(self) -> None:
        """One round trip."""
        request = PlanRequest(goal=JointGoal(kind="joints", position=BEHIND_POST), start=HOME, optimize_s=0)
        began = time.perf_counter()
        plan = self._operator.call(KEYS.plan, request, timeout=PATIENCE)
        self.plans.append(time.perf_counter() - began)
        self.outside.append(self.plans[-1] - plan.timings.total)

    def command(self, sequence: int) -> None:
        """One way."""
        rows = tuple(tuple(0.1 * k + 0.01 * j for j in range(6)) for k in range(POINTS))
        times = tuple(0.02 * k for k in range(POINTS))
        names = tuple(f"joint_{j}" for j in range(1, 7))
        message = DriverCommand(
            sequence=sequence,
            joint_names=names,
            based_on=0.0,
            expires_after=0.1,
            time=times,
            position=rows,
            velocity=rows,
            acceleration=rows,
        )
        self._arrived.clear()
        began = time.perf_counter()
        self._publisher.put(message)
        if self._arrived.wait(1.0):  # the first ones may come before the router knows who listens
            self.commands.append(time.perf_counter() - began)


def main() -> None:
    """Print one table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--plans", type=int, default=100)
    parser.add_argument("--commands", type=int, default=1000)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as name, ExitStack() as stack:
        folder = Path(name)
        zarm("certs", str(folder / "certs"))
        on = {"ZARM_SECURITY": "on", "ZARM_CERTS": str(folder / "certs")}
        folders = [Path(stack.enter_context(tempfile.TemporaryDirectory())) for _ in range(2)]
        sides = {
            "without": Side({"ZARM_SECURITY": "off"}, folders[0], stack),
            "with certificates": Side(on, folders[1], stack),
        }
        turns = [list(sides.values()), list(reversed(sides.values()))]
        for number in range(options.plans):
            for side in turns[number % 2]:
                side.plan()
        for number in range(options.commands):
            for side in turns[number % 2]:
                side.command(number + 1)
    table = Table(
        "",
        "plan ms: median",
        "95 %",
        "outside planning: median",
        "95 %",
        "command ms: median",
        "95 %",
        "99 %",
        box=None,
    )
    figures = {
        name: np.array(
            [
                *np.percentile(side.plans, [50, 95]),
                *np.percentile(side.outside, [50, 95]),
                *np.percentile(side.commands, [50, 95, 99]),
            ]
        )
        * 1000
        for name, side in sides.items()
    }
    for name, row in figures.items():
        table.add_row(name, *(f"{value:.2f}" for value in row))
    table.add_row("ratio", *(f"{value:.2f}" for value in figures["with certificates"] / figures["without"]))
    Console(width=120).print(table)


if __name__ == "__main__":
    main()
