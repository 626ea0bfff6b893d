"""compute_cartesian_path: straight lines through waypoints, as far as they can be followed."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from typing import Any

from moveit_msgs.msg import MoveItErrorCodes as Val

from zarm_contract.errors import PlanningFailed
from zarm_contract.messages import PathGoal, PathPoint, Plan, PlanRequest, Pose, TipFrame
from zarm_geometry.frames import pose_of
from zarm_ros_bridge.convert.fields import finite
from zarm_ros_bridge.convert.joints import known_as
from zarm_ros_bridge.convert.poses import pose_of as ros_pose_of
from zarm_ros_bridge.engine import Engine
from zarm_ros_bridge.frames import Frames
from zarm_ros_bridge.moveit.arm_groups import ArmGroups
from zarm_ros_bridge.moveit.constraint_set import ConstraintSet
from zarm_ros_bridge.moveit.curves import Speeds
from zarm_ros_bridge.moveit.error_codes import Refusal
from zarm_ros_bridge.moveit.requests import Scales
from zarm_ros_bridge.moveit.states import start_of
from zarm_ros_bridge.transforms import between

MAX_WAYPOINTS = 1000
"""Most waypoints of a path."""
_SHORTER = 0.01
"""Share of the path by which it ends before what cannot be followed, and by which it is shortened again if that fails."""
_TRIES = 5


class CartesianPaths:
    """Plans such paths. Thread-safe."""

    def __init__(self, engine: Engine, frames: Frames, groups: ArmGroups) -> None:
        self._engine = engine
        self._frames = frames
        self._groups = groups

    def plan(self, request: Any, ask: Callable[[PlanRequest], Plan]) -> tuple[Plan | None, float]:
        """The plan along the path of a request, or along its first part, and the share (0..1) that this is.

        Raises Refusal, and the planner's errors but for a path that cannot be followed to its end.
        """
        group = self._groups.of(request.group_name)
        if not finite(request.max_step, "max_step") > 0.0:
            raise Refusal(
                Val.FAILURE, "max_step is the distance of two points of the path; give one above 0", "max_step"
            )
        if not 0 < len(request.waypoints) <= MAX_WAYPOINTS:
            raise Refusal(
                Val.INVALID_GOAL_CONSTRAINTS,
                f"{len(request.waypoints)} waypoints; a path has 1 to {MAX_WAYPOINTS}",
                "waypoints",
            )
        descriptor, links = group.robot.descriptor, self._frames.links
        link = known_as(request.link_name, links.links) or descriptor.tip_link
        if link not in links.links:
            raise Refusal(
                Val.INVALID_LINK_NAME,
                f"the robot has no link {request.link_name!r}; choose among {', '.join(links.links)}",
                "link_name",
            )
        start = start_of(request.start_state, self._frames, self._engine.joints, "start_state")
        begin = start or self._frames.joints()
        poses = [pose_of(links.poses(begin)[link])] + [
            self._frames.in_base(ros_pose_of(pose, f"waypoints[{i}]"), request.header, "header")
            for i, pose in enumerate(request.waypoints)
        ]
        scales = Scales.of(request)
        most = finite(request.max_cartesian_speed, "max_cartesian_speed")
        speeds = Speeds.of(descriptor.tool, scales.velocity, scales.acceleration, most)
        kept = ConstraintSet(request.path_constraints, self._engine, self._frames, "path_constraints")
        if kept and not kept.holds(begin):
            raise Refusal(
                Val.START_STATE_VIOLATES_PATH_CONSTRAINTS,
                "the start is outside the path constraints; move the robot inside first, or widen them",
                "path_constraints",
            )

        def along(points: Sequence[Pose]) -> Plan:
            goal = PathGoal(
                kind="path",
                points=tuple(PathPoint(position=pose.position, orientation=pose.orientation) for pose in points[1:]),
                speed=speeds.speed,
                acceleration=speeds.acceleration,
                rotational_speed=speeds.rotational_speed,
                tip=None if link == descriptor.tip_link else TipFrame(link=link),
            )
            return ask(PlanRequest(goal=goal, group=group.name, start=start))

        return _as_far_as_possible(poses, along, kept, speeds)


def _as_far_as_possible(
    poses: Sequence[Pose], along: Callable[[Sequence[Pose]], Plan], kept: ConstraintSet, speeds: Speeds
) -> tuple[Plan | None, float]:
    lengths = [_length(a, b, speeds) for a, b in itertools.pairwise(poses)]
    if sum(lengths) < 1e-6:
        raise Refusal(Val.INVALID_GOAL_CONSTRAINTS, "the waypoints are where the robot is", "waypoints")
    share = 1.0
    for _ in range(_TRIES):
        try:
            plan = along(_first_part(poses, lengths, share))
        except PlanningFailed as error:
            share *= (1.0 if error.problem.fraction is None else error.problem.fraction) - _SHORTER
        else:
            if not kept or (followed := _kept_share(plan, kept)) == 1.0:
                return plan, share
            share *= followed - _SHORTER
        if share <= _SHORTER:
            break
    return None, 0.0


def _kept_share(plan: Plan, kept: ConstraintSet) -> float:
    """The share of a plan, by time, in which the constraints hold: the tip keeps its speed on most of a path."""
    trajectory = plan.trajectory
    for time, position in zip(trajectory.time, trajectory.position, strict=True):
        if not kept.holds(position):
            return time / trajectory.duration
    return 1.0


def _length(a: Pose, b: Pose, speeds: Speeds) -> float:
    """The length (m) of a line; a turn that takes longer counts as the distance that the tip moves in its time."""
    turn = abs(sum(p * q for p, q in zip(a.orientation, b.orientation, strict=True)))
    angle = 2.0 * math.acos(min(turn, 1.0))
    return max(math.dist(a.position, b.position), angle * speeds.speed / speeds.rotational_speed)


def _first_part(poses: Sequence[Pose], lengths: Sequence[float], share: float) -> list[Pose]:
    """The points of the first `share` of a polyline."""
    left = share * sum(lengths)
    points = [poses[0]]
    for (a, b), length in zip(itertools.pairwise(poses), lengths, strict=True):
        if left >= length - 1e-9:
            points.append(b)
            left -= length
            continue
        if left > 1e-6:
            points.append(pose_of(between(a, b, left / length)))
        break
    return points if len(points) > 1 else [poses[0], pose_of(between(poses[0], poses[1], 0.5))]
