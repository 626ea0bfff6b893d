"""A global plan: the planner's path in joint space to a live target, and the point on it to steer for."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import product

import numpy as np

from zarm_contract.errors import DeadlineExceeded, PlanningFailed, ZarmError
from zarm_contract.messages import JointGoal, Plan, PlanRequest, Pose, PoseGoal
from zarm_geometry.frames import pose_of
from zarm_servo.tracking.targets import JointTarget, PoseTarget
from zarm_trajectory.arrays import Array
from zarm_trajectory.trajectory import TimedTrajectory

PlanFor = Callable[[PlanRequest, float], Plan]
"""Asks the planner, which has the given time (s). Raises the planner's error, and Unavailable if there is no planner."""

TIMEOUT = 0.5
"""Time limit (s) for the planner when a target is first asked for, and for poses near it."""
_EXTRA_MARGIN = 0.005
"""Extra clearance (m) of a plan beyond the margin, where possible, so that following it never gets stuck."""
_RINGS = (0.02, 0.05, 0.1, 0.2, 0.4)
"""Distances (m) from an unreachable pose at which the planner tries others."""
_SAMPLE = 0.02
"""Seconds between two positions of the plan."""


class GlobalPlan:
    """A path through `positions` (N, J) to where `target` was. With a `refusal`, the planner's error for the target
    itself, the path leads to a place near it.
    """

    def __init__(self, positions: Array, target: PoseTarget | JointTarget, refusal: ZarmError | None = None) -> None:
        self.target, self.refusal = target, refusal
        self._positions = positions
        steps = np.abs(np.diff(positions, axis=0)).max(axis=1)
        self._lengths = np.append(0.0, np.cumsum(steps))
        self._passed = 0

    @property
    def left(self) -> float:
        """Remaining length of the path (rad); each step counts as far as the joint that moves most."""
        return float(self._lengths[-1] - self._lengths[self._passed])

    def advance(self, position: Array, within: float) -> None:
        """The robot is at `position` (J,): move on to the nearest path position, at most `within` (rad) ahead of the
        last one.
        """
        end = int(np.searchsorted(self._lengths, self._lengths[self._passed] + within, side="right"))
        away = np.abs(self._positions[self._passed : end] - position).max(axis=1)
        self._passed += int(np.argmin(away))

    def ahead(self, length: float) -> Array:
        """The position (J,) on the path `length` (rad) ahead of the robot, or its end."""
        wanted = self._lengths[self._passed] + length
        return np.array([np.interp(wanted, self._lengths, joint) for joint in self._positions.T])


def find_global_plan(
    ask: PlanFor,
    joints: tuple[str, ...],
    margin: float,
    target: PoseTarget | JointTarget,
    start: Array,
    distance: float,
    timeout: float,
) -> GlobalPlan:
    """A plan from rest at `start` (J,) to a target, `margin` (m) away from everything. Each request for the target itself has
    `timeout` (s).

    If a pose, `distance` (m) away, cannot be reached, the plan leads to a pose with the same orientation that is closer
    to it than the robot. Raises the planner's error for the target.
    """

    def plan(goal: PoseGoal | JointGoal, margin: float, timeout: float) -> Array:
        request = PlanRequest(
            goal=goal,
            group=target.group if isinstance(target, PoseTarget) else None,
            start=tuple(start.tolist()),
            margin=margin,
            self_margin=margin,
            timeout=timeout,
            optimize_s=0.0,
            publish=False,
        )
        trajectory = TimedTrajectory.of(ask(request, timeout).trajectory, joints)
        return trajectory.positions(np.linspace(0.0, trajectory.duration, 2 + int(trajectory.duration / _SAMPLE)))

    refusal: ZarmError | None = None
    goal = _goal(target)
    for kept in (margin + _EXTRA_MARGIN, margin):
        try:
            return GlobalPlan(plan(goal, kept, timeout), target)
        except (PlanningFailed, DeadlineExceeded) as error:
            refusal = error
    for nearer in _nearer(target, distance):
        try:
            return GlobalPlan(plan(nearer, margin + _EXTRA_MARGIN, TIMEOUT), target, refusal)
        except (PlanningFailed, DeadlineExceeded):
            continue
    raise refusal or PlanningFailed("there is no plan", code="no_path")


def _goal(target: PoseTarget | JointTarget) -> PoseGoal | JointGoal:
    if isinstance(target, JointTarget):
        return JointGoal(kind="joints", position=tuple(target.position.tolist()))
    return _poses(target, target.pose[None, :3, 3])


def _poses(target: PoseTarget, places: Array) -> PoseGoal:
    """A goal set: the orientation of the target at each of these places (N, 3)."""
    turn = pose_of(target.pose).orientation
    first, *others = (Pose(position=tuple(place.tolist()), orientation=turn) for place in places)
    return PoseGoal(
        kind="pose",
        position=first.position,
        orientation=first.orientation,
        alternatives=tuple(others),
        tolerance=target.tolerance,
    )


def _nearer(target: PoseTarget | JointTarget, distance: float) -> Iterator[PoseGoal]:
    """Goal sets around a pose, closest first, that are closer to it than `distance` (m)."""
    if isinstance(target, JointTarget):
        return
    ways = np.array([way for way in product((-1.0, 0.0, 1.0), repeat=3) if any(way)])
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    for radius in _RINGS:
        if radius < distance:
            yield _poses(target, target.pose[:3, 3] + radius * ways)
