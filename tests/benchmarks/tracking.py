"""What the local controller of the servo does with live targets: `python tests/benchmarks/tracking.py`.

The M1013 in free space and beside a wall: how far it lags behind a pose that moves at 0.1 m/s and is told 100 times a second without its velocity, how
fast it still goes along a wall and towards one 5 cm from it, and the CPU time of a cycle, which has 4 ms.
"""

from __future__ import annotations

import time

import numpy as np
from rich.console import Console
from rich.table import Table

from zarm_contract.messages import Cuboid, SceneObject
from zarm_contract.robot import load_robot
from zarm_geometry.exact import ExactScene
from zarm_geometry.motion_check import MotionCheck
from zarm_geometry.robot_model import RobotModel
from zarm_geometry.world import World
from zarm_servo.kernels.step import PERIOD
from zarm_servo.tracking.controller import Controller
from zarm_servo.tracking.targets import PoseTarget, Target, TwistTarget
from zarm_trajectory.arrays import Array
from zarm_trajectory.limits import Limits

MARGIN = 0.01
SPEED = 0.1
"""Of the target, m/s."""
TOLD = 0.01
"""Seconds from one target to the next."""
NEAR = 0.05
"""Metres from the wall at which the speed is read."""


class Run:
    """A controller, what it has commanded and the CPU seconds of its cycles."""

    def __init__(self, model: RobotModel, objects: list[SceneObject]) -> None:
        self.model = model
        self.world = World(objects, 0.0)
        check = MotionCheck(model)
        check.set_world(self.world)
        start = np.array(model.robot.descriptor.home) + 0.1
        self.controller = Controller(model, check, Limits.of(model.robot), start, margin=MARGIN)
        self.tips = [model.fk_tip(start)]
        self.states = [self.controller.state]
        self.seconds: list[float] = []

    def cycle(self, target: Target, age: float = 0.0) -> None:
        began = time.thread_time()
        state = self.controller.step(target, age).state
        self.seconds.append(time.thread_time() - began)
        self.states.append(state)
        self.tips.append(self.model.fk_tip(state[0]))


def main() -> None:
    """Print the table."""
    model = RobotModel.of(load_robot("doosan_m1013"))
    free, wall = Run(model, []), wall_before(model)
    lags = []
    for cycle in range(1000):
        reported = TOLD * (cycle * PERIOD // TOLD)
        pose, before = at(free.tips[0], reported), at(free.tips[0], max(reported - TOLD, 0.0))
        free.cycle(PoseTarget(pose).moving(before, TOLD), cycle * PERIOD - reported)
        away = at(free.tips[0], (cycle + 1) * PERIOD)[:3, 3] - free.tips[-1][:3, 3]
        lags.append(float(np.linalg.norm(away)) / SPEED)
    for _ in range(1000):
        wall.cycle(TwistTarget(np.array([0.2, 0.1, 0.0, 0.0, 0.0, 0.0])))
    scene = ExactScene(model, wall.world)
    distances = [scene.nearest(state[0], itself=False).distance for state in wall.states[::10]]
    near = 10 * int(np.argmax(np.array(distances) < NEAR))
    towards, along = ((wall.tips[near + 5][:3, 3] - wall.tips[near][:3, 3]) / (5 * PERIOD))[:2]
    table = Table("what", "figure")
    table.add_row("lag behind a target at 0.1 m/s, median from 1 s on", f"{1e3 * np.median(lags[250:]):.1f} ms")
    table.add_row("the same, largest", f"{1e3 * np.max(lags[250:]):.1f} ms")
    table.add_row(
        "asked for: 0.2 m/s towards a wall and 0.1 m/s along it; kept at 5 cm", f"{towards:.3f}, {along:.3f} m/s"
    )
    table.add_row("nearest to the wall, with a margin of 10 mm", f"{1e3 * min(distances):.1f} mm")
    for name, run in (("in free space", free), ("beside a wall", wall)):
        median, most = 1e3 * np.percentile(run.seconds[20:], (50, 99))
        table.add_row(f"cycle {name}, median and p99", f"{median:.2f}, {most:.2f} ms")
    Console(width=140).print(table)


def at(tip: Array, time: float) -> Array:
    """Where a target is that moves along y."""
    pose = tip.copy()
    pose[1, 3] += SPEED * time
    return pose


def wall_before(model: RobotModel) -> Run:
    """A run with a wall across x, 0.2 m in front of the tip."""
    x = float(Run(model, []).tips[0][0, 3]) + 0.2 + 0.05
    return Run(model, [Cuboid(kind="cuboid", name="wall", position=(x, 0.0, 0.5), size=(0.1, 4.0, 3.0))])


if __name__ == "__main__":
    main()
