"""Compiles every kernel before the first request, or loads it from the cache.

Run `python -m zarm_planner.warm_up` after an installation, so that no planner has to compile them.
"""

from __future__ import annotations

import itertools
import math
import signal
import sys
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace

import numpy as np

from zarm_contract.errors import PlanningFailed
from zarm_contract.messages import LineGoal, PathConstraint, PoseTolerance
from zarm_contract.robot import load_robot
from zarm_geometry.collision import is_free
from zarm_geometry.dynamics import Dynamics
from zarm_geometry.exact import ExactScene
from zarm_geometry.frames import pose_of
from zarm_geometry.robot_model import RobotModel
from zarm_geometry.voxels import merged
from zarm_geometry.world import World
from zarm_planner.cartesian.following import Following
from zarm_planner.cartesian.joint_curve import JointCurve
from zarm_planner.cartesian.task import ToolTask
from zarm_planner.cartesian.timing import time_along
from zarm_planner.constraints.constrained_search import led_to, search_constrained, shortcut_constrained
from zarm_planner.constraints.path_constraint import ConstraintManifold
from zarm_planner.context import PlanningContext
from zarm_planner.deadline import Deadline
from zarm_planner.goals.contact import clear_pose, way_out
from zarm_planner.kernels.leg_times import path_time, straight_times
from zarm_planner.kinematics.ik import solve_ik
from zarm_planner.kinematics.pose_region import PoseRegion
from zarm_planner.scene.planning_scene import PlanningScene
from zarm_planner.search.rrt_connect import search
from zarm_planner.search.shortcut import quickest_of, shortcut
from zarm_planner.timing.lead_in import ways_to_rest
from zarm_planner.timing.pace import paced
from zarm_planner.timing.rounding import rounded
from zarm_planner.timing.smoothing import brake_to_rest, least_duration, smooth_path
from zarm_planner.timing.torque import within_torque
from zarm_planner.verification.verify import VerificationFailed, verify
from zarm_trajectory.limits import Limits

STAGES = 10


def warm_up(model: RobotModel, report: Callable[[str], None]) -> None:
    """Run each kernel once; `report` is told what comes next. About 70 s after an installation, then 0.3 s.

    The compiled kernels serve every robot and every scene; nothing is compiled after this.
    """
    number = itertools.count(1)

    def begin(stage: str) -> None:
        report(f"loading {stage} ({next(number)} of {STAGES})")

    world, deadline = World((), 0.0), Deadline(math.inf)  # a slow machine compiles for minutes
    home = np.array(model.robot.descriptor.home)
    begin("forward kinematics")
    pose = model.fk_tip(home)
    begin("collision checks")
    is_free(model, world, home)
    merged(np.zeros((1, 3), np.int64))
    begin("inverse kinematics")
    solve_ik(model, pose, home, world=world, max_solutions=1, seed=0, deadline=deadline)
    region = PoseRegion.of(model, pose_of(pose), PoseTolerance(), None, "tip")
    region.solve(home, world=world, max_solutions=1, seed=0, deadline=deadline)
    region.deviation(home)
    begin("the search")
    search(model, world, home, home, seed=0, deadline=deadline)
    every = np.ones(model.dof)  # the robot's own may be too low for a motion that fits into a message
    limits = replace(Limits.of(model.robot), velocity=every, acceleration=5.0 * every, jerk=50.0 * every)
    straight_times(home[None], home[None], limits.velocity, limits.acceleration, 2)
    path_time(home[None], limits.velocity, limits.acceleration, 2)
    least_duration(home, home[None], limits, 0.01)
    begin("the shortcuts of paths")
    shortcut(model, world, np.array((home, home)), seed=0, deadline=deadline)
    quickest_of(model, world, home, home, model.velocity, math.inf, seeds=(0,), deadline=deadline, most=1)
    begin("the smoothing of motions")
    away = np.clip(home + 0.1, model.lower, model.upper)
    trajectory = smooth_path(model, world, np.array((home, away)), limits, 0.01, seed=0, deadline=deadline)
    state = np.stack((home, 0.1 * limits.velocity, np.zeros(model.dof)))
    for lead_in in ways_to_rest(model, world, state, limits, 0.01, vias=False, seed=0):
        brake_to_rest(model, world, lead_in, limits, 0.01)
        break
    begin("the verification of motions")
    exact = ExactScene(model, world)
    trajectory = rounded(trajectory, limits)
    with suppress(VerificationFailed):  # the robot may collide with itself near its home
        verify(trajectory, home, away, limits, exact, lambda: None)
    unknown = np.full(model.dof, np.inf)
    dynamics = model.dynamics or Dynamics.of(model.tree, (), unknown)
    within_torque(dynamics, trajectory, limits)
    paced(trajectory, trajectory.time, trajectory.states, np.zeros((4, *trajectory.position.shape)), limits)
    begin("ways out of tight places")
    context = PlanningContext(PlanningScene("0-000000000000", model, world, exact), limits, deadline)
    clear_pose(context, pose, home)
    way_out(context, home, np.eye(model.dof)[0])
    begin("motions along a curve")
    x, y, z = pose[:3, 3].tolist()
    for way in (0.02, 10.0):  # the second out of reach
        line = LineGoal(kind="line", position=(x, y, z + way), orientation_tolerance=("free", "free", "free"))
        with suppress(PlanningFailed):
            task = ToolTask.of(model, line, home)
            followed = Following(context.scene, deadline, 0, task.curve, task, home).path()
            joints = JointCurve.of(task.curve, followed)
            task.use_between(joints)
            time_along(task.curve, joints, limits, 0.01)
    begin("the search under path constraints")
    constraint = ConstraintManifold.of(model, PathConstraint(axes=(False, False, False, True, True, True)), home)
    constraint.use(home)
    led_to(constraint, home, home[None])
    path = search_constrained(world, constraint, home, home[None], seed=0, deadline=deadline)
    if path is not None:
        shortcut_constrained(world, constraint, path, seed=0, deadline=deadline)


def _print_line(text: str) -> None:
    sys.stdout.write(f"{text}\n")
    sys.stdout.flush()


def main() -> int:
    """Compile all kernels."""
    warm_up(RobotModel.of(load_robot("doosan_m1013")), _print_line)
    return 0


if __name__ == "__main__":
    signal.signal(signal.SIGINT, signal.SIG_DFL)  # Ctrl-C ends it at once, without a traceback; the cache stays whole
    sys.exit(main())
