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
from zarm_geometry import packed_shapes
from zarm_perception.robot_shape import RobotShapes

SCALE = 0.3
"""Share of the joints' speeds."""
LINKS = {*UR5E.descriptor.collision}
CANDIDATES = 24
"""Boxes of which one is chosen."""
APPEARING = 0.4
"""s that the simulation takes at most to have the box."""
RESTS = 0.005
"""A robot whose joints are slower (rad/s) rests."""
WATCHED = 2.5
"""s for which a held motion is watched."""


class Boxes:
    """Boxes where the tip will be late in a motion, and how near the robot comes to each: looked at before it moves, since that takes a while."""

    def __init__(self, plan: Plan, rng: np.random.Generator) -> None:
        every = slice(None, None, 5)
        self._times = np.array(plan.trajectory.time)[every]
        self._positions = np.array(plan.trajectory.position)[every]
        self._boxes = [self._drawn(rng) for _ in range(CANDIDATES)]
        parts = [RobotShapes(MODEL).at(there).parts for there in self._positions]
        self._distances = np.array(
            [[packed_shapes.distances(_points(box), one).min() for one in parts] for box in self._boxes]
        )

    def ahead(self, position: tuple[float, ...]) -> Cuboid | None:
        """One that is 10 cm from wherever the robot can be when it appears; None if there is none."""
        now = self._times[_index(self._positions, position)]
        soon = (self._times >= now) & (self._times <= now + APPEARING)
        far = np.flatnonzero(self._distances[:, soon].min(axis=1) > 0.1)
        return self._boxes[far[0]] if len(far) else None

    def _drawn(self, rng: np.random.Generator) -> Cuboid:
        tip = MODEL.fk_tip(self._positions[int(rng.uniform(0.6, 0.95) * len(self._positions))])[:3, 3]
        place, size = tip + rng.uniform(-0.05, 0.05, 3), rng.uniform(0.06, 0.15, 3)
        return Cuboid(kind="cuboid", name="box", position=tuple(place.tolist()), size=tuple(size.tolist()))


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
        if packed_shapes.distances(_points(box), RobotShapes(MODEL).at(there).parts).min() < 0.002:
            return float(time_there - times[now]), float(braking)
    return float("inf"), float(braking)


def touches(cell: Cell) -> bool:
    """Whether the robot touches the box now."""
    pairs = [{one.first, one.second} for one in cell.robot.simulation.state().contacts]
    return any("box" in pair and pair & LINKS for pair in pairs)


def trial(cell: Cell, goal: tuple[float, ...], rng: np.random.Generator) -> tuple[bool, bool, bool, bool] | None:
    """Whether the box was too near, whether a motion was held, whether it touched the box, and whether it went on to its goal; None if no box lay ahead."""
    plan = cell.robot.plan(goal, velocity_scale=SCALE)
    boxes = Boxes(plan, rng)
    running = cell.robot.start(plan)
    time.sleep(float(rng.uniform(0.0, 0.2)) * plan.trajectory.time[-1])
    box = boxes.ahead(cell.robot.joint_state().position)
    if box is None:
        cell.robot.follow(running)
        return None
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
            if (tried := trial(cell, BACK if number % 2 else THERE, rng)) is None:
                continue
            found.append(tried)
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
