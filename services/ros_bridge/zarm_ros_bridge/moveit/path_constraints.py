"""Path constraints of MoveIt: a motion that keeps to them."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from moveit_msgs.msg import MoveItErrorCodes as Val

from zarm_contract.errors import InvalidRequest, PlanningFailed
from zarm_contract.messages import PathConstraint, Plan, PlanRequest
from zarm_ros_bridge.link_frames import LinkFrames
from zarm_ros_bridge.moveit.constraint_set import FREE, ConstraintSet, deviation
from zarm_ros_bridge.moveit.error_codes import Refusal
from zarm_ros_bridge.moveit.states import Positions

_WIDE = 1.0
"""Half an edge (m) from which a box does not hold its axis: no robot is held inside a cell by it."""
_ANGLES = (0.001, 0.5)
_DISTANCES = (0.0005, 0.1)
"""The tolerances that a path constraint of zarm may have."""


def constrained_plan(
    request: PlanRequest,
    constraints: ConstraintSet,
    start: Positions,
    tip: str,
    links: LinkFrames,
    request_plan: Callable[[PlanRequest], Plan],
) -> Plan:
    """A plan whose every sample keeps the constraints; `tip` is the tip link of the robot with these `links`.

    Most motions keep them anyway. Otherwise the components that they bound are held as at the start, which is more than they
    ask. Raises Refusal, and what `request_plan` raises.
    """
    if not constraints.holds(start):
        raise Refusal(
            Val.START_STATE_VIOLATES_PATH_CONSTRAINTS,
            "the start is outside the path constraints; move the robot inside first, or widen them",
            "path_constraints",
        )
    plan = request_plan(request)
    if kept(plan, constraints):
        return plan
    end = plan.trajectory.position[-1]
    try:  # also to a goal that this motion did not keep them at: one with freedom may be reached in another way
        plan = request_plan(request.model_copy(update={"path_constraint": _held(constraints, start, tip, links)}))
    except (InvalidRequest, PlanningFailed) as error:
        if constraints.holds(end):
            raise
        raise Refusal(
            Val.GOAL_VIOLATES_PATH_CONSTRAINTS, "the goal is outside the path constraints", "path_constraints"
        ) from error
    if kept(plan, constraints):
        return plan
    raise PlanningFailed("no motion was found that keeps the path constraints; widen them", field="path_constraints")


def kept(plan: Plan, constraints: ConstraintSet) -> bool:
    """Whether every sample of a plan keeps the constraints."""
    return all(map(constraints.holds, plan.trajectory.position))


def _held(constraints: ConstraintSet, start: Positions, tip: str, links: LinkFrames) -> PathConstraint:
    """What of the tip's pose at the start is to stay, for the constraints to be kept."""
    at = links.poses(start)
    held = {one.link for one in constraints.positions} | {one.link for one in constraints.orientations}
    turns = {link: _axes_of(at[tip], at[link]) for link in held if links.rigid(link) == links.rigid(tip)}
    if constraints.joints or any(turns.get(link) is None for link in held):
        raise PlanningFailed(
            f"the motion found breaks the path constraints, and only those of {tip}, or of a link that is fixed to it along the "
            "same axes, can be planned for; widen the others",
            field="path_constraints",
        )
    if constraints.orientations and constraints.positions:
        raise PlanningFailed(
            "the motion found breaks the path constraints, and position and orientation cannot both be planned for; widen one",
            field="path_constraints",
        )
    if constraints.orientations:
        return _turning(constraints, at, turns)
    return _moving(constraints, at)


def _axes_of(tip: Any, link: Any) -> tuple[int, ...] | None:
    """For each axis of a link, which of the tip's is along it; None if they are not along each other."""
    along = np.abs(tip[:3, :3].T @ link[:3, :3])
    axes = along.argmax(axis=0)
    return tuple(axes.tolist()) if np.allclose(along.max(axis=0), 1.0, atol=1e-6) else None


def _turning(
    constraints: ConstraintSet, at: dict[str, Any], turns: Mapping[str, tuple[int, ...] | None]
) -> PathConstraint:
    axes, tolerance = [False] * 3, _ANGLES[1]
    for orientation in constraints.orientations:
        along = turns[orientation.link] or (0, 1, 2)
        off = deviation(orientation, at[orientation.link][:3, :3])
        free = any(most >= FREE for most in orientation.tolerance)
        for i, (most, now) in enumerate(zip(orientation.tolerance, off, strict=True)):
            if most < FREE:
                axes[along[i]] = True
                tolerance = min(tolerance, (most - now) * (math.sqrt(0.5) if free else 1.0))
    x, y, z = axes
    return PathConstraint(axes=(x, y, z, False, False, False), frame="tool", angle_tolerance=max(tolerance, _ANGLES[0]))


def _moving(constraints: ConstraintSet, at: dict[str, Any]) -> PathConstraint:
    axes, tolerance = [False] * 3, _DISTANCES[1]
    for region in constraints.positions:
        inside = np.abs(np.linalg.inv(region.pose) @ at[region.link] @ np.append(region.offset, 1.0))[:3]
        half = np.array(region.half if region.half is not None else [(region.radius or 0.0) / math.sqrt(3.0)] * 3)
        turn = np.abs(region.pose[:3, :3])  # the box's axes in the base frame
        for i in range(3):
            if half[i] < _WIDE:
                along = int(np.argmax(turn[:, i]))
                axes[along] = True
                tolerance = min(tolerance, float(half[i] - inside[i]))
    x, y, z = axes
    return PathConstraint(axes=(False, False, False, x, y, z), position_tolerance=max(tolerance, _DISTANCES[0]))
