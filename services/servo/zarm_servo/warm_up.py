"""Compile the kernels of the check, or load what an earlier process compiled.

`python -m zarm_servo.warm_up` does it after an installation, so that no servo has to.
"""

from __future__ import annotations

import sys

import numpy as np

from zarm_contract.messages import Cuboid
from zarm_contract.robot import load_robot
from zarm_geometry.meshes import Meshes
from zarm_geometry.robot_model import RobotModel
from zarm_servo.check import Checker
from zarm_servo.world import Seen
from zarm_trajectory.trajectory import TimedTrajectory


def warm_up(model: RobotModel, checker: Checker) -> None:
    """Check a robot at rest once, with an object far away."""
    box = Cuboid(kind="cuboid", name="far", position=(0.0, 0.0, 50.0), size=(1.0, 1.0, 1.0))
    standing = TimedTrajectory.standing(np.array(model.robot.descriptor.home))
    checker.way(standing, 0.0, Seen(objects={"far": box}), None)


def main() -> int:
    """Compile all kernels."""
    model = RobotModel.of(load_robot("doosan_m1013"))
    warm_up(model, Checker(model, Meshes()))
    return 0


if __name__ == "__main__":
    sys.exit(main())
