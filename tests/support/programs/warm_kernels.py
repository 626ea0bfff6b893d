"""Prints which kernels a planner still compiles after its warm-up: run in a separate process."""

from __future__ import annotations

import importlib
import pkgutil
import sys

import numpy as np

from zarm_contract.messages import Cuboid, JointGoal, PathConstraint, PoseGoal, Sphere, Voxels, WaypointsGoal
from zarm_contract.robot import load_robot
from zarm_geometry import kernels as geometry_kernels
from zarm_geometry.exact import ExactScene
from zarm_geometry.frames import pose_of
from zarm_geometry.robot_model import RobotModel
from zarm_geometry.world import World
from zarm_planner import kernels as planner_kernels
from zarm_planner.constraints.path_constraint import constrains
from zarm_planner.context import PlanningContext
from zarm_planner.deadline import Deadline
from zarm_planner.pipeline import plan
from zarm_planner.planners.registry import choose
from zarm_planner.scene.planning_scene import PlanningScene
from zarm_planner.warm_up import warm_up
from zarm_trajectory.limits import Limits


def compiled() -> dict[str, int]:
    """How often each kernel is compiled in this process."""
    names = [
        f"{kernels.__name__}.{module.name}"
        for kernels in (geometry_kernels, planner_kernels)
        for module in pkgutil.iter_modules(kernels.__path__)
    ]
    return {
        f"{name}.{key}": len(value.signatures)
        for name in names
        for key, value in vars(importlib.import_module(name)).items()
        if hasattr(value, "signatures")
    }


def every_kind_of_plan(model: RobotModel) -> None:
    """To joints, to a pose, through waypoints, and with axes held; around an obstacle if there is one."""
    home = np.array(model.robot.descriptor.home)
    away = home + 0.8 * (np.arange(model.dof) == 0)
    pose = pose_of(model.fk_tip(away))
    to_joints = JointGoal(kind="joints", position=tuple(away.tolist()))
    to_pose = PoseGoal(kind="pose", position=pose.position, orientation=pose.orientation)
    through = WaypointsGoal(
        kind="waypoints", through=(to_pose, JointGoal(kind="joints", position=tuple(home.tolist())))
    )
    x, y, z = model.fk_tip((home + away) / 2)[:3, 3].tolist()
    post = Cuboid(kind="cuboid", name="post", position=(x, y, z + 0.05), size=(0.03, 0.03, 0.02))
    ball = Sphere(kind="sphere", name="ball", position=(0.0, 0.0, 3.0), radius=0.1)
    crumbs = Voxels(
        kind="voxels", name="crumbs", position=(0.0, 0.0, 3.5), resolution=0.1, cells=((0, 0, 0), (0, 0, 1))
    )
    upright = PathConstraint(axes=(True, True, False, False, False, False), angle_tolerance=0.1)
    for objects in ((), (ball, crumbs, post)):
        world = World(objects, 0.005)
        snapshot = PlanningScene("1-000000000000", model, world, ExactScene(model, world))
        for goal in (to_joints, to_pose, through):
            for held in (None, upright):
                limits, deadline = Limits.of(model.robot), Deadline(60.0)
                context = PlanningContext(snapshot, limits, deadline, held, max_attempts=10, optimize_s=0.05)
                plan(choose("auto", goal, constrains(held)), context, home, goal)
        slowly = np.stack((0.05 * limits.velocity, np.zeros(model.dof)))
        context = PlanningContext(snapshot, limits, Deadline(60.0), None, max_attempts=10, optimize_s=0.05)
        plan(choose("auto", to_joints, False, moving=True), context, home, to_joints, slowly)


if __name__ == "__main__":
    warm_up(RobotModel.of(load_robot("doosan_m1013")), lambda _: None)
    before = compiled()
    for robot in ("doosan_m1013", "panda"):
        every_kind_of_plan(RobotModel.of(load_robot(robot)))
    for name, count in compiled().items():
        if count > before[name]:
            sys.stdout.write(f"{name}\n")
