"""LIN, CIRC and POLYLINE of the Pilz planner as lines, arcs and paths of the tip."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from moveit_msgs.msg import MoveItErrorCodes as Val

from zarm_contract.descriptor import ToolSpeeds
from zarm_contract.messages import (
    ArcGoal,
    CartesianGoal,
    LineGoal,
    PathGoal,
    PathPoint,
    Pose,
    TipFrame,
)
from zarm_geometry.frames import pose_of
from zarm_ros_bridge.convert.poses import pose_of as ros_pose_of
from zarm_ros_bridge.engine import Engine
from zarm_ros_bridge.frames import Frames
from zarm_ros_bridge.moveit.arm_groups import ArmGroup
from zarm_ros_bridge.moveit.constraint_set import ConstraintSet
from zarm_ros_bridge.moveit.error_codes import Refusal
from zarm_ros_bridge.moveit.goals import pose_goal


@dataclass(frozen=True)
class Speeds:
    """How the tip moves: speed (m/s), acceleration (m/s²) and rotational speed (rad/s)."""

    speed: float
    acceleration: float
    rotational_speed: float

    @classmethod
    def of(cls, tool: ToolSpeeds, velocity_scale: float, acceleration_scale: float, most: float) -> Speeds:
        """Shares of the descriptor's; `most` (m/s) bounds the speed, unless it is 0."""
        speed = velocity_scale * tool.speed
        return cls(
            min(speed, most) if most > 0.0 else speed,
            acceleration_scale * tool.acceleration,
            velocity_scale * tool.rotational_speed,
        )


class Curves:
    """Reads requests for motions along a curve."""

    def __init__(self, engine: Engine, frames: Frames) -> None:
        self._engine = engine
        self._frames = frames

    def goal(
        self, planner: str, request: Any, start: Sequence[float], speeds: Speeds, group: ArmGroup
    ) -> CartesianGoal:
        """The goal of a request with the planner LIN, CIRC or POLYLINE for a group, from the robot's joints `start` (rad). Raises
        Refusal.
        """
        if len(request.goal_constraints) != 1:
            raise Refusal(
                Val.INVALID_GOAL_CONSTRAINTS,
                f"{planner} has one goal, and not {len(request.goal_constraints)}",
                "goal_constraints",
            )
        end, tip, free = self._end(request, start, group)
        options: dict[str, Any] = {
            "speed": speeds.speed,
            "acceleration": speeds.acceleration,
            "rotational_speed": speeds.rotational_speed,
            "tip": tip,
        }
        turned = None if free else end.orientation
        if planner == "LIN":
            return LineGoal(kind="line", position=end.position, orientation=turned, **options)
        if planner == "CIRC":
            return ArcGoal(kind="arc", position=end.position, orientation=turned, **self._circle(request), **options)
        return PathGoal(kind="path", points=self._points(request, end), **options)

    def _end(self, request: Any, start: Sequence[float], group: ArmGroup) -> tuple[Pose, TipFrame | None, bool]:
        """The pose at the end, the frame that has it there, and whether its orientation is not given."""
        links, robot = self._frames.links, group.robot
        field = "goal_constraints[0]"
        constraints = ConstraintSet(request.goal_constraints[0], self._engine, self._frames, field)
        if constraints.joints and not (constraints.positions or constraints.orientations):
            at = {one.joint: one.position for one in constraints.joints}
            reached = tuple(at.get(joint, now) for joint, now in zip(self._engine.joints, start, strict=True))
            return pose_of(links.poses(reached)[robot.descriptor.tip_link]), None, False
        if not constraints.positions:
            raise Refusal(
                Val.INVALID_GOAL_CONSTRAINTS, "a line, an arc or a polyline ends at a position; constrain it", field
            )
        goal = pose_goal(constraints, robot, links.poses(start)[robot.descriptor.tip_link], field)
        return (
            Pose(position=goal.position, orientation=goal.orientation),
            goal.tip,
            not constraints.orientations,
        )

    def _circle(self, request: Any) -> dict[str, Any]:
        name, points = request.path_constraints.name, request.path_constraints.position_constraints
        which = {"interim": "via", "center": "center"}.get(name)
        if which is None or len(points) != 1:
            raise Refusal(
                Val.INVALID_MOTION_PLAN,
                "CIRC has one position constraint in path_constraints, whose name is interim or center",
                "path_constraints",
            )
        return {which: self._point(points[0], request, "path_constraints.position_constraints[0]").position}

    def _points(self, request: Any, end: Pose) -> tuple[PathPoint, ...]:
        waypoints = request.path_constraints.position_constraints
        if len(waypoints) < 2:
            raise Refusal(
                Val.INVALID_MOTION_PLAN,
                "POLYLINE has two waypoints at least, the last of them the goal, as position constraints of path_constraints",
                "path_constraints.position_constraints",
            )
        poses = [
            self._point(one, request, f"path_constraints.position_constraints[{i}]") for i, one in enumerate(waypoints)
        ]
        if max(abs(a - b) for a, b in zip(poses[-1].position, end.position, strict=True)) > 1e-6:
            poses.append(end)
        return tuple(PathPoint(position=pose.position, orientation=pose.orientation) for pose in poses)

    def _point(self, constraint: Any, request: Any, field: str) -> Pose:
        """The pose of a constraint's region, in its own frame or else in that of the goal."""
        region = constraint.constraint_region
        if not region.primitive_poses:
            raise Refusal(Val.INVALID_MOTION_PLAN, "the region has no pose", f"{field}.constraint_region")
        header = constraint.header
        if not header.frame_id and request.goal_constraints[0].position_constraints:
            header = request.goal_constraints[0].position_constraints[0].header
        pose = ros_pose_of(region.primitive_poses[0], f"{field}.constraint_region.primitive_poses[0]")
        return self._frames.in_base(pose, header, f"{field}.header")
