"""Compiles the kernels of the motion check and of the local controller, or loads them from the cache.

Run `python -m zarm_servo.warm_up` after an installation, so that no servo has to compile them.
"""

from __future__ import annotations

import signal
import sys
from collections.abc import Callable

import numpy as np

from zarm_contract.messages import Cuboid, Voxels
from zarm_contract.robot import load_robot
from zarm_geometry.dynamics import Dynamics
from zarm_geometry.meshes import Meshes
from zarm_geometry.robot_model import RobotModel
from zarm_servo.kernels.nearest import nearest_time
from zarm_servo.tracking.controller import Controller
from zarm_servo.tracking.receding_horizon import MAX_INTERVALS, nearest_motion
from zarm_servo.tracking.targets import TwistTarget
from zarm_servo.world.check import Checker, SceneCheck
from zarm_servo.world.moving_objects import Mover
from zarm_servo.world.scene_monitor import SceneSnapshot
from zarm_trajectory.limits import Limits
from zarm_trajectory.trajectory import TimedTrajectory


def warm_up(checker: Checker, check: SceneCheck, report: Callable[[str], None]) -> None:
    """Check a robot at rest, and take a step of a session: with objects far away, and with one at its tip. `report` is told what
    comes next.
    """
    report("loading the check of motions")
    model, box = check.model, Cuboid(kind="cuboid", name="far", position=(0.0, 0.0, 50.0), size=(1.0, 1.0, 1.0))
    cell = Voxels(kind="voxels", name="cell", position=box.position, resolution=1.0, cells=((0, 0, 0),))
    home = np.array(model.robot.descriptor.home)
    tip = box.model_copy(update={"name": "tip", "position": tuple(model.fk_tip(home)[:3, 3].tolist())})
    standing = TimedTrajectory.standing(home)
    nearest_time(standing.time, standing.coefficients, home, 0.0, 0.1)
    checker.validity(standing, 0.0, SceneSnapshot(objects={"far": box}), None)
    mover = Mover(box, box, (0.1, 0.0, 0.0), 0.1, 0.0, 0.0)
    checker.validity_among(standing, 0.0, SceneSnapshot(), [mover], 0.0, 0.5)
    dynamics = model.dynamics or Dynamics.of(model.tree, (), np.full(model.dof, np.inf))
    dynamics.holding(home[None])
    report("loading the control of sessions")
    controller = Controller(model, check.motions, Limits.of(model.robot), home, margin=0.01)
    for item in (box, cell, tip):
        check.load({item.name: item})
        controller.step(TwistTarget(np.zeros(6)), 0.0).braking.at(0.0)
        controller.follow(controller.state)
    check.load({})
    nearest_motion(controller.state, np.tile(home, (MAX_INTERVALS, 1)), Limits.of(model.robot))


def main() -> int:
    """Compile all kernels."""
    model = RobotModel.of(load_robot("doosan_m1013"))
    warm_up(Checker(model, Meshes()), SceneCheck(model, Meshes()), lambda _: None)
    return 0


if __name__ == "__main__":
    signal.signal(signal.SIGINT, signal.SIG_DFL)  # Ctrl-C ends it at once, without a traceback; the cache stays whole
    sys.exit(main())
