"""Goals of MoveIt as goals of zarm."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Literal

import numpy as np
from moveit_msgs.msg import MoveItErrorCodes as Val
from numpy.typing import NDArray

from zarm_contract.messages import Goal, JointGoal, Pose, PoseGoal, PoseTolerance, TipFrame
from zarm_contract.robot import RobotDescription
from zarm_geometry.frames import pose_of
from zarm_ros_bridge.moveit.constraint_set import FREE, ConstraintSet, Orientation, PointRegion
from zarm_ros_bridge.moveit.error_codes import Refusal

Array = NDArray[np.float64]
Bounds = tuple[float | Literal["free"], float | Literal["free"], float | Literal["free"]]

EXACT_DISTANCE, EXACT_ANGLE = 0.002, 0.01
"""Tolerances (m, rad) up to which a goal is planned for exactly: they stand for "here", and an exact pose is found sooner."""
_FARTHEST = 100.0  # m, the largest bound of a distance


def goals_of(sets: Sequence[ConstraintSet], start: Sequence[float], robot: RobotDescription, tip: Array) -> list[Goal]:
    """The goals that are alternatives, in order; poses that differ in nothing else are one goal.

    `start` are the joints (rad) where the motion begins, and keep what is not constrained; `tip` is the pose (4, 4) of the tip
    there. Raises Refusal.
    """
    goals: list[Goal] = []
    for i, constraints in enumerate(sets):
        goal = _goal(constraints, start, robot, tip, f"goal_constraints[{i}]")
        before = goals[-1] if goals else None
        if (
            isinstance(goal, PoseGoal)
            and isinstance(before, PoseGoal)
            and (goal.tolerance, goal.tip) == (before.tolerance, before.tip)
            and len(before.poses) < 64
        ):
            other = Pose(position=goal.position, orientation=goal.orientation)
            goals[-1] = before.model_copy(update={"alternatives": (*before.alternatives, other)})
        else:
            goals.append(goal)
    return goals


def pose_goal(constraints: ConstraintSet, robot: RobotDescription, tip: Array, field: str) -> PoseGoal:
    """The goal of a set with a position, an orientation or both, of one link; without a position it may be anywhere.

    `tip` is the pose (4, 4) of the tip now, from which a free component is sought. Raises Refusal.
    """
    if len(constraints.positions) > 1 or len(constraints.orientations) > 1:
        raise Refusal(
            Val.INVALID_GOAL_CONSTRAINTS, "a goal has one position and one orientation at most, of one link", field
        )
    region = next(iter(constraints.positions), None)
    orientation = next(iter(constraints.orientations), None)
    if region is not None and orientation is not None and region.link != orientation.link:
        raise Refusal(
            Val.INVALID_GOAL_CONSTRAINTS,
            f"the position is of {region.link} and the orientation of {orientation.link}; constrain one link",
            field,
        )
    link = (region or orientation).link  # type: ignore[union-attr] # one of them is there
    turned = tip[:3, :3] if orientation is None else orientation.rotation
    pose = np.eye(4)
    pose[:3, :3] = turned
    pose[:3, 3] = tip[:3, 3] if region is None else region.pose[:3, 3]
    placed = pose_of(pose)
    free: Bounds = ("free", "free", "free")
    position, radius, frame = (free, None, "tool") if region is None else _position(region, turned)
    about = free if orientation is None else _angles(orientation)
    tolerance = PoseTolerance(orientation=about, position=position, radius=radius, frame=frame)
    offset = (0.0, 0.0, 0.0) if region is None else region.offset
    plain = link == robot.descriptor.tip_link and not any(offset)
    return PoseGoal(
        kind="pose",
        position=placed.position,
        orientation=placed.orientation,
        tolerance=tolerance if any(about) or any(position) or radius else None,
        tip=None if plain else TipFrame(link=link, offset=Pose(position=offset)),
    )


def _goal(constraints: ConstraintSet, start: Sequence[float], robot: RobotDescription, tip: Array, field: str) -> Goal:
    if not constraints:
        raise Refusal(Val.INVALID_GOAL_CONSTRAINTS, "there is no goal; constrain joints, or the pose of a link", field)
    if not constraints.joints:
        return pose_goal(constraints, robot, tip, field)
    if constraints.positions or constraints.orientations:
        raise Refusal(
            Val.INVALID_GOAL_CONSTRAINTS,
            "joints and a pose are constrained together; constrain one of them",
            field,
        )
    return JointGoal(kind="joints", position=tuple(_joints(constraints, start, robot, field)))


def _joints(constraints: ConstraintSet, start: Sequence[float], robot: RobotDescription, field: str) -> Iterator[float]:
    """Positions within all bounds: those that are asked for, moved into the range of the joint."""
    lower, upper = robot.range_about(start)
    for joint, at, low, high in zip(robot.descriptor.joints, start, lower, upper, strict=True):
        bounds = [one for one in constraints.joints if one.joint == joint]
        if not bounds:
            yield at
            continue
        least = max(one.low for one in bounds)
        most = min(one.high for one in bounds)
        if robot.continuous[robot.descriptor.joints.index(joint)]:
            low, high = -math.inf, math.inf
        if least > most or least > high or most < low:
            raise Refusal(
                Val.INVALID_GOAL_CONSTRAINTS,
                f"no position of {joint} is within {least:.4f} to {most:.4f} and its range, {low:.4f} to {high:.4f}",
                f"{field}.joint_constraints",
            )
        yield min(max(bounds[0].position, least, low), most, high)


def _position(region: PointRegion, turned: Array) -> tuple[Bounds, float | None, Literal["base", "tool"]]:
    """Bounds of a box, or the radius of a ball, and the frame of the box; a box that is turned otherwise is planned for as
    the ball inside it.
    """
    exact: Bounds = (0.0, 0.0, 0.0)
    if region.half is None:
        radius = region.radius or 0.0
        return exact, radius if radius > EXACT_DISTANCE else None, "tool"
    if max(region.half) <= EXACT_DISTANCE:
        return exact, None, "tool"
    turn = region.pose[:3, :3]
    for frame, axes in (("base", np.eye(3)), ("tool", turned)):
        along = axes.T @ turn  # the box's axes, as seen from this frame
        if np.allclose(np.sort(np.abs(along), axis=1), [0.0, 0.0, 1.0], atol=1e-6):
            x, y, z = (min(value, _FARTHEST) for value in (np.abs(along) @ np.array(region.half)).tolist())
            return (x, y, z), None, "base" if frame == "base" else "tool"
    least = min(region.half)
    return exact, least if least > 0.0 else None, "tool"


def _angles(orientation: Orientation) -> Bounds:
    """Bounds of the rotation vector inside which the constraint holds.

    For small angles it and Euler angles differ by products of two. Where one axis is free, a tilt may lie between the other
    two, and each has its share of that.
    """
    tolerance = orientation.tolerance
    free = [most >= FREE for most in tolerance]
    largest = max((most for most, is_free in zip(tolerance, free, strict=True) if not is_free), default=0.0)
    if all(free) or (largest <= EXACT_ANGLE and not any(free)):
        return ("free", "free", "free") if all(free) else (0.0, 0.0, 0.0)
    share = (math.sqrt(0.5) if any(free) else 1.0) * (max(1.0 - largest, 0.2) if orientation.euler else 1.0)
    bounds: list[float | Literal["free"]] = [
        "free" if is_free else share * most for most, is_free in zip(tolerance, free, strict=True)
    ]
    return bounds[0], bounds[1], bounds[2]
