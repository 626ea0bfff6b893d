"""What `generate_trajectory` is asked for."""

from __future__ import annotations

from collections.abc import Sequence

from curobo_msgs.srv import TrajectoryGeneration
from zarm_contract.errors import InvalidRequest
from zarm_contract.messages import JointGoal, PathConstraint, Pose, PoseGoal, WaypointsGoal
from zarm_ros_bridge.convert.fields import finite
from zarm_ros_bridge.convert.poses import is_given, pose_of

MOST_POSES = 100
"""Waypoints of one motion at most."""

_AXES = ("theta_x", "theta_y", "theta_z", "x", "y", "z")
_READS = {"batch": "target_poses", "multipoint": "target_poses", "joint_space": "target_joint_positions"}
"""The goal that a planner reads where that is not `target_pose`."""


def target_of(request: TrajectoryGeneration.Request, planner: str) -> str:
    """Which field of the request is its goal: the one that the active planner reads, or, that being empty, the only one filled in.

    Raises InvalidRequest where none is filled in, or where it could be either of two.
    """
    filled = [
        field
        for field, there in (
            ("target_pose", is_given(request.target_pose)),
            ("target_poses", len(request.target_poses)),
            ("target_joint_positions", len(request.target_joint_positions)),
        )
        if there
    ]
    wanted = _READS.get(planner, "target_pose")
    if wanted in filled:
        return wanted
    if not filled:
        raise InvalidRequest(f"there is no goal; fill in {wanted}, which the planner {planner} reads", field=wanted)
    if len(filled) > 1:
        raise InvalidRequest(
            f"{' and '.join(filled)} are filled in, and {wanted}, which the planner {planner} reads, is not; fill in one goal "
            "alone, or choose another planner with set_planner",
            field=filled[0],
        )
    return filled[0]


def poses_of(request: TrajectoryGeneration.Request) -> tuple[Pose, ...]:
    """`target_poses`. Raises InvalidRequest."""
    if len(request.target_poses) > MOST_POSES:
        raise InvalidRequest(
            f"{len(request.target_poses)} poses are more than {MOST_POSES}; ask for the motion in parts",
            field="target_poses",
        )
    return tuple(pose_of(pose, f"target_poses[{i}]") for i, pose in enumerate(request.target_poses))


def pose_goal(pose: Pose) -> PoseGoal:
    """The goal to bring the tip to a pose."""
    return PoseGoal(kind="pose", position=pose.position, orientation=pose.orientation)


def goal_of(
    request: TrajectoryGeneration.Request, target: str, joints: Sequence[str]
) -> PoseGoal | JointGoal | WaypointsGoal:
    """The goal in the field `target`. Raises InvalidRequest."""
    if target == "target_pose":
        return pose_goal(pose_of(request.target_pose, target))
    if target == "target_poses":
        return WaypointsGoal(kind="waypoints", through=tuple(map(pose_goal, poses_of(request))))
    values = tuple(request.target_joint_positions)
    if len(values) != len(joints):
        raise InvalidRequest(
            f"{len(values)} positions for the {len(joints)} joints {', '.join(joints)}; give one for each, in this order",
            field=target,
        )
    return JointGoal(kind="joints", position=tuple(finite(value, f"{target}[{i}]") for i, value in enumerate(values)))


def path_constraint_of(request: TrajectoryGeneration.Request, target: str) -> PathConstraint | None:
    """What the whole motion keeps of the tip's pose at its start, in the base frame.

    `trajectories_contraints` have six for each of `target_poses`; since a motion holds an axis all the way or not at all, they
    must be the same for all, and the same as `trajectory_constraints` where both are given. Raises InvalidRequest.
    """
    whole = _axes(request.trajectory_constraints, "trajectory_constraints")
    if len(whole) > 1:
        raise InvalidRequest(
            f"{6 * len(whole)} constraints; give six, for {', '.join(_AXES)}, or none", field="trajectory_constraints"
        )
    each = _axes(request.trajectories_contraints, "trajectories_contraints")
    if each and any(map(any, each)) and target != "target_poses":
        raise InvalidRequest(
            f"these are for target_poses, and {target} is planned to; give trajectory_constraints",
            field="trajectories_contraints",
        )
    if target == "target_poses" and each:
        if len(each) != len(request.target_poses):
            raise InvalidRequest(
                f"constraints for {len(each)} of {len(request.target_poses)} target_poses; give six for each, or none",
                field="trajectories_contraints",
            )
        if len(set(each + whole)) > 1:
            raise InvalidRequest(
                "the constraints differ from pose to pose, and a path constraint holds for the whole motion; give all poses the same, "
                "or ask for the motion in parts",
                field="trajectories_contraints",
            )
        whole = each[:1]
    axes = whole[0] if whole else (False,) * 6
    return PathConstraint(axes=axes) if any(axes) else None


def _axes(values: Sequence[int], field: str) -> list[tuple[bool, bool, bool, bool, bool, bool]]:
    rest = len(values) % 6
    if rest:
        raise InvalidRequest(
            f"{len(values)} constraints are no multiple of six; give {', '.join(_AXES)} for each", field=field
        )
    for i, value in enumerate(values):
        if value not in (0, 1):
            raise InvalidRequest(f"{value} is neither 0 (free) nor 1 (constrained)", field=f"{field}[{i}]")
    rows = [tuple(bool(value) for value in values[i : i + 6]) for i in range(0, len(values), 6)]
    return [(a, b, c, d, e, f) for a, b, c, d, e, f in rows]
