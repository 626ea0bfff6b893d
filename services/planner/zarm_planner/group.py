"""The joints that a request moves: those of its groups, while the others stand."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from zarm_contract.errors import InvalidRequest
from zarm_contract.messages import CartesianGoal, Goal, GroupsGoal, JointGoal, PoseGoal, WaypointsGoal
from zarm_contract.robot import RobotDescription
from zarm_geometry.exact import ExactScene
from zarm_planner.context import PlanningContext
from zarm_planner.pipeline import Verified, plan
from zarm_planner.planners.base import Planner
from zarm_planner.scene.planning_scene import PlanningScene
from zarm_trajectory.arrays import Array
from zarm_trajectory.trajectory import TimedTrajectory


@dataclass(frozen=True)
class Group:
    """The groups `names` of a robot as one; `joints` (n,) are the indices of its joints among the robot's."""

    names: tuple[str, ...]
    joints: NDArray[np.intp]

    @classmethod
    def of(cls, robot: RobotDescription, name: str | None, goal: Goal, field: str = "") -> Self | None:
        """The group of a goal; None if it is for all joints. Raises InvalidRequest that names the `group` after the
        prefix `field`.
        """
        if isinstance(goal, GroupsGoal):
            if name is not None:
                raise InvalidRequest("each goal of the goal names its group; leave this out", field=f"{field}group")
            _check_apart(robot, goal, f"{field}goal")
            return cls._named(robot, tuple(part.group for part in goal.goals))
        if _poses_in(goal):
            robot.check_tip(name, f"{field}group")
        if name is None:
            return None
        robot.group_joints(name, f"{field}group")
        return cls._named(robot, (name,))

    @classmethod
    def of_tip(cls, robot: RobotDescription, name: str | None) -> Self | None:
        """The group whose tip a request is about; None if the robot has one tip, which all joints move. Raises
        InvalidRequest.
        """
        robot.check_tip(name)
        if name is None:
            return None
        return cls._named(robot, (name,))

    @classmethod
    def _named(cls, robot: RobotDescription, names: tuple[str, ...]) -> Self:
        moving = robot.group(*names).descriptor.joints
        return cls(names, np.array([robot.descriptor.joints.index(joint) for joint in moving], np.intp))

    def with_group(self, robot: RobotDescription, name: str) -> Self:
        """This group and another one as one."""
        return self._named(robot, (*self.names, name))

    def scene(self, scene: PlanningScene, q: Array) -> PlanningScene:
        """A scene of the whole robot as one of the group, whose other joints stand as in `q` (dof,)."""
        model = scene.exact.model.group(self.names, q)  # what was measured of it once is kept there
        grouped = PlanningScene(scene.revision, model, scene.world, ExactScene(model, scene.exact.world))
        return grouped.with_self_margin(scene.self_margin)

    def plan(
        self, planner: Planner, context: PlanningContext, start: Array, goal: Goal, motion: Array | None
    ) -> Verified:
        """`pipeline.plan` of the group from joints `start` and `motion` of the whole robot, in a context of it."""
        standing = np.setdiff1d(np.arange(len(start)), self.joints)
        if motion is not None and motion[:, standing].any():
            joint = context.limits.joints[standing[np.abs(motion[:, standing]).max(axis=0).argmax()]]
            raise InvalidRequest(
                f"{joint} moves, but is not of the group, whose other joints stand; leave the group out, or let it come to rest",
                field="start_state.velocity",
            )
        verified = plan(
            planner,
            self.context(context, start),
            start[self.joints],
            goal,
            None if motion is None else motion[:, self.joints],
        )
        return self.whole(verified, start)

    def context(self, context: PlanningContext, q: Array) -> PlanningContext:
        """A context of the whole robot as one of the group, whose other joints stand as in `q` (dof,)."""
        return replace(context, scene=self.scene(context.scene, q), limits=context.limits.part(self.joints))

    def whole(self, verified: Verified, q: Array) -> Verified:
        """A motion of the group as one of the whole robot, whose other joints stand as in `q` (dof,)."""
        motion = verified.trajectory
        position = np.tile(q, (len(motion.time), 1))
        velocity, acceleration = np.zeros_like(position), np.zeros_like(position)
        position[:, self.joints] = motion.position
        velocity[:, self.joints] = motion.velocity
        acceleration[:, self.joints] = motion.acceleration
        return replace(verified, trajectory=TimedTrajectory(motion.time, position, velocity, acceleration))


def _poses_in(goal: Goal) -> bool:
    """Whether a goal is about the tip."""
    if isinstance(goal, WaypointsGoal):
        return any(isinstance(waypoint, PoseGoal) for waypoint in goal.through)
    return isinstance(goal, PoseGoal | CartesianGoal)


def _check_apart(robot: RobotDescription, goal: GroupsGoal, field: str) -> None:
    """Raises InvalidRequest for groups that share a joint, and for those with several tips."""
    owner: dict[str, str] = {}
    for number, part in enumerate(goal.goals):
        at = f"{field}.goals.{number}.group"
        for joint in robot.group_joints(part.group, at):
            if joint in owner:
                raise InvalidRequest(
                    f"{part.group} and {owner[joint]} share the joint {joint}, which cannot follow two goals; name a group without it",
                    field=at,
                )
            owner[joint] = part.group
        if robot.descriptor.groups[part.group].groups and not isinstance(part.goal, JointGoal):
            raise InvalidRequest(f"{part.group} has several tips; name its groups, each with its goal", field=at)
