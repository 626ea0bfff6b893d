"""Things that appear in the way of a moving robot: `python tests/benchmarks/dropped.py [--count 50]`.

A UR5e with mass swings to and fro. Somewhere ahead of its tip a box of 6 to 15 cm appears, seen by two simulated cameras at 10 Hz. *Held* are the motions
that were held, *touched* those in which the simulation had a contact of robot and box, *went on* those that came to their goal after the box was taken away. Where
the box appears nearer than the robot can brake, which happens where the machine is busy, the motion is counted as *too near* alone.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np
from rich.console import Console
from rich.table import Table

from support.harness import eventually
from support.seeing_cell import BACK, FLOOR, FRONT, MODEL, SIDE, THERE, UR5E, Cell, cell_of
from zarm_contract.messages import Cuboid, Plan
from zarm_geometry import rows
from zarm_perception.robot_shape import RobotShapes

SCALE = 0.3
"""Share of the joints' speeds."""
LINKS = {*UR5E.descriptor.collision}
APPEARING = 0.4
"""s that the simulation takes at most to have the box."""
RESTS = 0.005
"""A robot whose joints are slower (rad/s) rests."""
WATCHED = 2.5
"""s for which a held motion is watched."""


def box_ahead(cell: Cell, plan: Plan, rng: np.random.Generator) -> Cuboid:
    """A box where the tip will be later, 10 cm from wherever the robot can be when the box appears."""
    times, positions = np.array(plan.trajectory.time), np.array(plan.trajectory.position)
    now = _index(positions, cell.robot.joint_state().position)
    soon = positions[(times >= times[now]) & (times <= times[now] + APPEARING)]
    robot = [RobotShapes(MODEL).at(there).parts for there in soon]
    while True:
        tip = MODEL.fk_tip(positions[int(rng.uniform(0.6, 0.95) * len(positions))])[:3, 3]
        place, size = tip + rng.uniform(-0.05, 0.05, 3), rng.uniform(0.06, 0.15, 3)
        box = Cuboid(kind="cuboid", name="box", position=tuple(place.tolist()), size=tuple(size.tolist()))
        if min(rows.distances(_points(box), parts).min() for parts in robot) > 0.1:
            return box


def _index(positions: np.ndarray, position: tuple[float, ...]) -> int:
    return int(np.linalg.norm(positions - position, axis=1).argmin())


def _points(box: Cuboid) -> np.ndarray:
    unit = np.stack(np.meshgrid(*[np.linspace(-0.5, 0.5, 7)] * 3), axis=-1).reshape(-1, 3)
    return np.array(box.position) + unit * box.size


def time_to(box: Cuboid, plan: Plan, position: tuple[float, ...]) -> tuple[float, float]:
    """How long (s) a motion from a position on it takes to the box without braking, and how long braking takes from there."""
    times, positions = np.array(plan.trajectory.time), np.array(plan.trajectory.position)
    velocity = np.abs(np.array(plan.trajectory.velocity))
    now = _index(positions, position)
    limits = UR5E.descriptor.cspace
    braking = (velocity[now] / limits.acceleration + np.divide(limits.acceleration, limits.jerk)).max()
    for time_there, there in zip(times[now:], positions[now:], strict=True):
        if rows.distances(_points(box), RobotShapes(MODEL).at(there).parts).min() < 0.002:
            return float(time_there - times[now]), float(braking)
    return float("inf"), float(braking)


def touches(cell: Cell) -> bool:
    """Whether the robot touches the box now."""
    pairs = [{one.first, one.second} for one in cell.robot.simulation.state().contacts]
    return any("box" in pair and pair & LINKS for pair in pairs)


def trial(cell: Cell, goal: tuple[float, ...], rng: np.random.Generator) -> tuple[bool, bool, bool, bool]:
    """Whether the box was too near, whether a motion was held, whether it touched the box, and whether it went on to its goal."""
    plan = cell.robot.plan(goal, velocity_scale=SCALE)
    running = cell.robot.start(plan)
    time.sleep(float(rng.uniform(0.0, 0.2)) * plan.trajectory.time[-1])
    box = box_ahead(cell, plan, rng)
    cell.world(FLOOR, box)
    held = touched = False
    appeared = time.monotonic()
    until = appeared + WATCHED
    away, braking = time_to(box, plan, cell.robot.joint_state().position)
    near = away <= braking
    for state in cell.robot.goal_states(running):
        if state.hold is not None and not held:
            held, seen = True, time.monotonic() - appeared
        if not touched and touches(cell):
            touched = True
            told = f"held after {seen:.2f} s" if held else "not held"
            touch = time.monotonic() - appeared
            Console().print(f"touched after {touch:.2f} s: {away:.2f} s away, braking takes {braking:.2f} s, {told}")
        if held and time.monotonic() > until:
            break
    cell.world(FLOOR)
    return near, held and not near, touched and not near, cell.robot.follow(running).status == "succeeded"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=50)
    arguments = parser.parse_args()
    rng, found = np.random.default_rng(0), []
    with tempfile.TemporaryDirectory() as folder, cell_of(Path(folder)) as cell:
        cell.world(FLOOR)
        cell.look(FRONT, SIDE)
        cell.robot.execute(cell.robot.plan(BACK))
        for number in range(arguments.count):
            found.append(trial(cell, BACK if number % 2 else THERE, rng))
            if not found[-1][-1]:
                eventually(lambda: max(map(abs, cell.robot.joint_state().velocity)) < RESTS, "the robot rests")
                cell.robot.reset()
                cell.robot.perception.clear()  # where the arm itself hides it, no camera sees that the box is gone
                cell.robot.execute(cell.robot.plan(BACK if number % 2 else THERE))
    table = Table("motions", "too near", "held", "touched", "went on")
    table.add_row(str(len(found)), *(str(sum(column)) for column in zip(*found, strict=True)))
    Console().print(table)


if __name__ == "__main__":
    main()
