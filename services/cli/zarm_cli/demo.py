"""`zarm demo`: a robot moves, with all services as processes on a private bus."""

from __future__ import annotations

import math
import os
import select
import socket
import sys
import tempfile
import time
from contextlib import nullcontext, suppress
from pathlib import Path
from typing import Annotated

import typer
from rich.panel import Panel
from rich.table import Table

import zarm
from zarm.robot import Robot
from zarm_cli.demo_physics import MAP, PANDA, WORLD, show
from zarm_cli.execution import demand_success, run_goal
from zarm_cli.interrupts import pause
from zarm_cli.launcher import SimulatedDriver, launch
from zarm_cli.output import err, facts, out, pose_text
from zarm_cli.planning import plan_table
from zarm_cli.view import VIEW
from zarm_contract.messages import ExecuteRequest, GoalState, Plan, Pose

ROBOT = "doosan_m1013"
# The tool starts at (0.56, 0.03, 0.65), swings by a quarter turn, and the post stands half-way.
TABLE = zarm.Cuboid("table", position=(0.4, 0.45, 0.28), size=(0.6, 0.6, 0.04))
POST = zarm.Cylinder("post", position=(0.38, 0.42, 0.6), radius=0.04, length=0.6)
GOAL = zarm.Pose((0.0, 0.55, 0.6), (-0.6, 0.8, 0.0, 0.0))
_SCALE = 0.4  # of the robot's limits: slow enough to watch


def demo(
    view: Annotated[bool, typer.Option("--view", help="Show it in the browser, and keep running.")] = False,
    physics: Annotated[
        bool,
        typer.Option(
            "--physics",
            help="A robot with mass clears a table whose blocks a depth camera sees, and goes around a parcel that falls.",
        ),
    ] = False,
) -> None:
    """Watch a robot plan around a post and move there. Nothing to set up, nothing left behind."""
    began = time.monotonic()
    robot, act = (PANDA, show) if physics else (ROBOT, _go_around_the_post)
    with (
        tempfile.TemporaryDirectory(prefix="zarm-demo-") as state,
        suppress(KeyboardInterrupt) if view else nullcontext(),  # the ordinary end of a demo that waits
        launch(
            robot,
            strategy=None if physics else "emulator",
            driver=SimulatedDriver.physics if physics else None,
            physics=WORLD if physics else (),
            perception=MAP if physics else None,
            listen=_free_endpoint(),
            state=Path(state),
            log_level="WARNING",
            view=os.environ.get("ZARM_VIEW", VIEW) if view else None,
        ) as stack,
    ):
        with err.status("starting") as status:
            stack.wait_ready(status.update)
        out.print(f"{robot}: router, planner and executor are ready after {time.monotonic() - began:.1f} s.")
        if view and sys.stdin.isatty():
            out.print("Open the page at the address printed here, then press Enter: the robot moves.")
            _wait_for_enter()
        act(stack.client)
        if view:
            out.print("The page stays open, and the robot is yours: Ctrl-C ends it.")
            stack.wait()
    out.print(
        "Next: `zarm demo --view` shows it in a browser; `zarm up` in one terminal, `zarm status` and `zarm watch` in another."
    )


def _wait_for_enter() -> None:
    while not select.select([sys.stdin], [], [], 0.0)[0]:
        pause(0.1)
    sys.stdin.readline()


def _go_around_the_post(robot: Robot) -> None:
    robot.scene.add(TABLE, POST)
    out.print("A table and a post are in the scene; the goal lies behind the post.")
    plan = robot.plan(GOAL, velocity_scale=_SCALE, acceleration_scale=_SCALE)
    table = plan_table(plan)
    table.add_row("straight on", _straight_on(robot, plan))
    out.print(Panel(table, title="plan", expand=False))
    last = run_goal(robot, ExecuteRequest(plan_id=plan.plan_id))
    demand_success(last)
    out.print(Panel(_result(last, robot.tip()), title="reached", expand=False))


def _straight_on(robot: Robot, plan: Plan) -> str:
    """What the straight line in joint space would do, between the same ends."""
    start, end = plan.trajectory.position[0], plan.trajectory.position[-1]
    line = tuple(tuple(a + (b - a) * step / 50 for a, b in zip(start, end, strict=True)) for step in range(51))
    worst = min(robot.check(line), key=lambda result: result.clearance)
    if not worst.in_collision:
        return "the straight joint motion would be free"
    return f"{' and '.join(worst.pair or ())} would meet, {-worst.clearance * 1e3:.0f} mm deep"


def _result(last: GoalState, reached: Pose) -> Table:
    off = math.dist(GOAL.position, reached.position)
    cosine = abs(sum(a * b for a, b in zip(GOAL.orientation, reached.orientation, strict=True)))
    turned = math.degrees(2 * math.acos(min(1.0, cosine)))
    return facts(
        ("motion", f"{last.status} after {last.elapsed:.2f} s"),
        ("tip", pose_text(reached)),
        ("off by", f"{off * 1e3:.3f} mm and {turned:.4f} deg"),
    )


def _free_endpoint() -> str:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{probe.getsockname()[1]}"
