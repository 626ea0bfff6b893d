"""`zarm demo --physics`: a Panda with mass clears a table of blocks that only a depth camera sees, and swerves around what falls into its way."""

from __future__ import annotations

import math
import time

from rich.panel import Panel
from rich.table import Table

import zarm
from zarm.robot import Robot
from zarm_cli.output import numbers, out
from zarm_contract.messages import Cuboid, GoalState

PANDA = "panda"
WORLD = ("--world", "blocks")
MAP = ("--box=0.2,-0.5,0.015,0.8,0.6,0.6", "--resolution", "0.01")
"""The map begins above the table: that is in the scene, so that the gripper may come close."""
TABLE = zarm.Cuboid("table", size=(1.0, 1.4, 0.1), position=(0.6, 0.0, -0.055))
CAMERA = zarm.Camera(
    "front", position=(1.1, -0.25, 0.75), look_at=(0.45, 0.0, 0.0), width=640, height=480, fx=600.0, fy=600.0, cx=319.5, cy=239.5
)  # fmt: skip
DOWN = (1.0, 0.0, 0.0, 0.0)
ACROSS = (zarm.Pose((0.45, 0.35, 0.25), DOWN), zarm.Pose((0.5, -0.25, 0.25), DOWN))
"""From above the tray to the other side of the table."""
PARCEL = zarm.Cuboid("parcel", size=(0.1, 0.1, 0.3), position=(0.48, -0.02, 0.7))
"""It falls between these."""
_LOWEST = 0.02
"""Least height (m) at which the gripper closes."""


def show(robot: Robot) -> None:
    """All of it."""
    clear_table(robot)
    swerve(robot)


def clear_table(robot: Robot) -> None:
    """Put every block that the camera sees into the tray."""
    robot.scene.add(TABLE)
    robot.perception.add(CAMERA)
    robot.perception.look()
    blocks = robot.perception.boxes(floor=0.0)
    out.print(f"A depth camera sees {len(blocks)} blocks; the planner knows no more of them.")
    robot.scene.add(*blocks)
    began, table = time.monotonic(), Table("block", "seen at (m)", "put to (m)", "stands at (m)", box=None)
    for n, block in enumerate(blocks):
        goal = (0.38 + 0.14 * (n % 2), 0.26 + 0.14 * (n // 2))
        _move(robot, block, goal)
        there = min((body.position[:2] for body in robot.simulation.state().bodies), key=lambda at: math.dist(at, goal))
        table.add_row(block.name, numbers(block.position[:2]), numbers(goal), numbers(there))
        out.print(f"{block.name} is in the tray")
    out.print(Panel(table, title=f"cleared in {time.monotonic() - began:.0f} s", expand=False))


def swerve(robot: Robot) -> None:
    """Let a parcel fall into the way of the arm, which stops for it and goes around."""
    robot.execute(robot.plan(ACROSS[0]))
    plan = robot.plan(ACROSS[1], velocity_scale=0.25, acceleration_scale=0.5)
    states: list[GoalState] = []

    def let_it_fall(state: GoalState) -> None:
        if not states:
            robot.simulation.add(PARCEL, mass=0.5)
            out.print("The arm goes back across the table, and a parcel falls into its way.")
        states.append(state)

    last = robot.execute(plan, replan=True, on_progress=let_it_fall)
    stopped = any(state.hold is not None for state in states)
    parcel = next(body for body in robot.simulation.state().bodies if body.name == PARCEL.name)
    aside = math.dist(parcel.position[:2], PARCEL.position[:2])
    how = "stopped and went around it" if stopped else "went around it without a stop"
    out.print(f"The arm {how}: {last.status} after {last.elapsed:.1f} s instead of {plan.trajectory.duration:.1f} s.")
    out.print(f"The parcel stands {1000.0 * aside:.0f} mm beside where it fell.")


def _move(robot: Robot, block: Cuboid, goal: tuple[float, float]) -> None:
    x, y, z = block.position
    half = math.atan2(block.orientation[2], block.orientation[3])
    across = [(math.cos(turn), math.sin(turn), 0.0, 0.0) for turn in (half, half + math.pi / 4.0)]  # either side of it
    poses = [zarm.Pose((x, y, max(z, _LOWEST)), side) for side in across]
    robot.pick(block.name, zarm.AnyOf(*poses), mass=0.2)
    robot.place(zarm.Pose((*goal, z + 0.015), DOWN))
