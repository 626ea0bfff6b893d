"""Goals of MoveIt as goals of zarm."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Literal

import numpy as np
from moveit_msgs.msg import MoveItErrorCodes as Val

from zarm_contract.messages import (
    Goal,
    GroupGoal,
    GroupsGoal,
    JointGoal,
    Joints,
    Pose,
    PoseGoal,
    PoseTolerance,
    TipFrame,
)
from zarm_contract.robot import RobotDescription
from zarm_geometry.frames import pose_of, rotated_by
from zarm_ros_bridge.moveit.arm_groups import arm_of
from zarm_ros_bridge.moveit.constraint_set import FREE, ConstraintSet, Orientation, PointRegion
from zarm_ros_bridge.moveit.error_codes import Refusal
from zarm_trajectory.arrays import Array

Bounds = tuple[float | Literal["free"], float | Literal["free"], float | Literal["free"]]

EXACT_DISTANCE, EXACT_ANGLE = 0.002, 0.01
"""Tolerances (m, rad) up to which a goal is planned for exactly: they stand for "here", and an exact pose is found sooner."""
_MAX_DISTANCE = 100.0  # m, the largest bound of a distance
_COMPONENT, _PRODUCT = 0.7, 0.6
"""Share of an Euler angle's tolerance for the component of the rotation vector; and how much of it the product of the two others takes."""
_MAX_POSES = 64  # poses of one goal
_NEAREST = 4
"""How many configurations that reach a pose with bounded joints are planned for, one after the other."""
_TILTED = math.radians(60.0)
"""How far (rad) a free turn about y goes to each side."""
_TILTS = tuple(_TILTED * i / 3 for i in (0, 1, -1, 2, -2, 3, -3))
_ROUND = tuple(math.pi * i / 4 for i in (0, 1, -1, 2, -2, 3, -3, 4))
_FEW_TILTS, _FEW_ROUND = _TILTS[:3], tuple(math.pi * i / 3 for i in (0, 1, -1, 2, -2, 3))
"""Fewer of both where they are combined: inverse kinematics of a pose that cannot be reached takes tens of milliseconds."""


def goals_of(
    sets: Sequence[ConstraintSet],
    start: Sequence[float],
    robot: RobotDescription,
    tip: Callable[[], Array],
    ik: Callable[[PoseGoal, Mapping[str, float]], Sequence[Joints]],
) -> list[Goal]:
    """The goals that are alternatives, in order; poses that differ in nothing else are one goal. Joints that are constrained together with a
    pose choose among the joints that reach it.

    `start` are the joints (rad) where the motion begins, and keep what is not constrained; `tip()` is the pose (4, 4) of the tip
    there, and `ik` gives many joints (rad) that reach a goal, near those that are given by name. Raises Refusal, and what `ik` raises.
    """
    goals: list[Goal] = []
    for i, constraints in enumerate(sets):
        field = f"goal_constraints[{i}]"
        if constraints.joints and (constraints.positions or constraints.orientations):
            _check_names(constraints, robot, field)
            pose = pose_goal(constraints, robot, tip(), field)
            solutions = ik(pose, {one.joint: one.position for one in constraints.joints})
            goals += _reaching(constraints, solutions, start, robot, field)
            continue
        goal = _goal(constraints, start, robot, tip, field)
        before = goals[-1] if goals else None
        if (
            isinstance(goal, PoseGoal)
            and isinstance(before, PoseGoal)
            and (goal.tolerance, goal.tip) == (before.tolerance, before.tip)
            and len(before.poses) + len(goal.poses) <= _MAX_POSES
        ):
            goals[-1] = before.model_copy(update={"alternatives": (*before.alternatives, *goal.poses)})
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
    free: Bounds = ("free", "free", "free")
    turns, about = ([tip[:3, :3]], free) if orientation is None else _turns(orientation)
    position, radius, frame = (free, None, "tool") if region is None else _position(region, turns[0])
    if len(turns) > 1 and frame == "tool" and len({*position}) > 1:  # the goals of a set have no frame in common
        position, radius = (0.0, 0.0, 0.0), min(region.half if region is not None and region.half else (0.0,)) or None
    tolerance = PoseTolerance(orientation=about, position=position, radius=radius, frame=frame)
    offset = (0.0, 0.0, 0.0) if region is None else region.offset
    plain = link == robot.descriptor.tip_link and not any(offset)
    pose = np.eye(4)
    pose[:3, 3] = tip[:3, 3] if region is None else region.pose[:3, 3]
    placed = []
    for turn in turns:
        pose[:3, :3] = turn
        placed.append(pose_of(pose))
    return PoseGoal(
        kind="pose",
        position=placed[0].position,
        orientation=placed[0].orientation,
        alternatives=tuple(placed[1:]),
        tolerance=tolerance if any(about) or any(position) or radius else None,
        tip=None if plain else TipFrame(link=link, offset=Pose(position=offset)),
    )


def tips_goal(
    constraints: ConstraintSet, arms: Mapping[str, RobotDescription], pose: Callable[[str], Array], field: str
) -> GroupsGoal:
    """The goal of a set that constrains the poses of links of some of the `arms`; the others stand. `pose` gives that of a link (4, 4) now. Raises
    Refusal.
    """
    if constraints.joints:
        raise Refusal(
            Val.INVALID_GOAL_CONSTRAINTS,
            "joints and poses of a group with several tips are not one goal; constrain joints, or poses of links",
            f"{field}.joint_constraints",
        )
    links: dict[str, list[str]] = {}
    for link in constraints.links:
        links.setdefault(arm_of(link, arms, field), []).append(link)
    goals = [
        GroupGoal(
            group=name,
            goal=pose_goal(constraints.of(moved), arms[name], pose(arms[name].descriptor.tip_link), field),
        )
        for name, moved in links.items()
    ]
    return GroupsGoal(kind="groups", goals=tuple(goals))


def _goal(
    constraints: ConstraintSet, start: Sequence[float], robot: RobotDescription, tip: Callable[[], Array], field: str
) -> Goal:
    if not constraints:
        raise Refusal(Val.INVALID_GOAL_CONSTRAINTS, "there is no goal; constrain joints, or the pose of a link", field)
    if not constraints.joints:
        return pose_goal(constraints, robot, tip(), field)
    return JointGoal(kind="joints", position=tuple(_joints(constraints, start, robot, field)))


def _reaching(
    constraints: ConstraintSet,
    solutions: Sequence[Joints],
    start: Sequence[float],
    robot: RobotDescription,
    field: str,
) -> list[Goal]:
    """The few of the joints that reach a pose that are inside the bounds and nearest to the start. Raises Refusal if there are none."""
    inside = [
        JointGoal(kind="joints", position=joints)
        for joints in sorted(solutions, key=lambda joints: float(np.abs(np.subtract(joints, start)).max()))
        if all(
            one.low <= dict(zip(robot.descriptor.joints, joints, strict=True))[one.joint] <= one.high
            for one in constraints.joints
        )
    ]
    if not inside:
        raise Refusal(
            Val.NO_IK_SOLUTION,
            f"none of {len(solutions)} configurations found for the pose has the joints inside their bounds; widen them",
            f"{field}.joint_constraints",
        )
    return [*inside[:_NEAREST]]


def _check_names(constraints: ConstraintSet, robot: RobotDescription, field: str) -> None:
    for one in constraints.joints:
        if one.joint not in robot.descriptor.joints:
            raise Refusal(
                Val.INVALID_GOAL_CONSTRAINTS,
                f"{one.joint} is not a joint of the group; those are {', '.join(robot.descriptor.joints)}",
                f"{field}.joint_constraints",
            )


def _joints(constraints: ConstraintSet, start: Sequence[float], robot: RobotDescription, field: str) -> Iterator[float]:
    """Positions within all bounds: those that are asked for, moved into the range of the joint."""
    _check_names(constraints, robot, field)
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
            x, y, z = (min(value, _MAX_DISTANCE) for value in (np.abs(along) @ np.array(region.half)).tolist())
            return (x, y, z), None, "base" if frame == "base" else "tool"
    least = min(region.half)
    return exact, least if least > 0.0 else None, "tool"


def _turns(orientation: Orientation) -> tuple[list[Array], Bounds]:
    """Rotations (3, 3) of the link, and bounds of the rotation vector from each of them inside which the constraint holds.

    Where one axis is free, a tilt may lie between the other two, and each has its share of that. Euler angles of which two are free are no such region: rotations about the
    two stand for it, and so do those about y where it alone is free, up to _TILTED, before its axes x and z become one.
    """
    tolerance, asked = orientation.tolerance, orientation.rotation
    free = [most >= FREE for most in tolerance]
    bounded = [most for most, is_free in zip(tolerance, free, strict=True) if not is_free]
    if not bounded:
        return [asked], ("free", "free", "free")
    if max(bounded) <= EXACT_ANGLE and not any(free):
        return [asked], (0.0, 0.0, 0.0)
    if not orientation.euler:
        return [asked], _bounds(tolerance, free)
    shrunk = max(1.0 - max(bounded), 0.2)
    if not any(free):
        return [asked], _small_turns(tolerance)
    share = math.sqrt(0.5) * shrunk * math.cos(_TILTED)
    least = share * min(bounded)
    match free:
        case [False, True, False]:
            return [asked], (least, _TILTED, least)
        case [False, True, True]:
            return [asked @ _about_y(b) for b in _TILTS], (least, least, "free")
        case [True, False, True]:
            return [asked @ _about_x(a) for a in _ROUND], (least, least, "free")
        case [True, True, False]:
            return [asked @ _about_x(a) @ _about_y(b) for b in _FEW_TILTS for a in _FEW_ROUND], (least, least, least)
    return [asked], _bounds([math.sqrt(0.5) * shrunk * min(bounded)] * 3, free)


def _small_turns(tolerance: Sequence[float]) -> Bounds:
    """Bounds of a rotation vector inside which Euler angles keep to their tolerances.

    Each angle is the component of the vector, and about half the product of the two others: the component has most of the
    tolerance, and the larger of the others is bounded so that the rest suffices.
    """
    bounds = [_COMPONENT * most for most in tolerance]
    for i, most in enumerate(tolerance):
        less, more = sorted(((i + 1) % 3, (i + 2) % 3), key=bounds.__getitem__)
        if bounds[less] > 0.0:
            bounds[more] = min(bounds[more], (1.0 - _COMPONENT) * most / (_PRODUCT * bounds[less]))
    return bounds[0], bounds[1], bounds[2]


def _bounds(tolerance: Sequence[float], free: Sequence[bool]) -> Bounds:
    bounds: list[float | Literal["free"]] = [
        "free" if is_free else most for most, is_free in zip(tolerance, free, strict=True)
    ]
    return bounds[0], bounds[1], bounds[2]


def _about_x(angle: float) -> Array:
    return np.asarray(rotated_by(np.array([[angle, 0.0, 0.0]]))[0])


def _about_y(angle: float) -> Array:
    return np.asarray(rotated_by(np.array([[0.0, angle, 0.0]]))[0])
