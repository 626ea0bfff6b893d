"""A motion of a group while other joints move too.

The way of the group is found with the others where they end, and begins as soon as all stay apart: a motion at a time, each planned among
those before it (Erdmann and Lozano-Perez, "On multiple moving objects", 1987), its path first and then when it is followed (Kant and
Zucker, "Toward efficient trajectory planning: the path-velocity decomposition", 1986). At the latest it begins when the others rest.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from zarm_contract.errors import InvalidRequest, PlanningFailed
from zarm_contract.messages import Goal, TooNear, Trajectory
from zarm_contract.robot import RobotDescription
from zarm_planner.context import PlanningContext
from zarm_planner.group import Group
from zarm_planner.pipeline import Verified
from zarm_planner.planners.base import Planner
from zarm_planner.verification.margins import too_near
from zarm_planner.verification.verify import VerificationFailed, verify
from zarm_trajectory.arrays import Array
from zarm_trajectory.limits import Limits
from zarm_trajectory.trajectory import MIN_INTERVAL, TimedTrajectory

_STARTS = 24
"""How many beginnings are tried before the others rest."""
_UNMOVED_TOLERANCE = 1e-6
"""A joint that moves less than this (rad) stands."""
_TORQUE_STEP = 0.003
"""Largest time (s) between two looks at the torques."""


@dataclass(frozen=True)
class ConcurrentMotion:
    """What the `joints`, by their indices (n,) among the robot's, do from the beginning on: their `motion`, which ends at rest."""

    joints: NDArray[np.intp]
    motion: TimedTrajectory

    @classmethod
    def of(cls, robot: RobotDescription, message: Trajectory, group: Group | None) -> Self:
        """The motion of a request for a plan of a group; joints that stand in it do not count. Raises InvalidRequest."""
        if group is None:
            raise InvalidRequest(
                "a motion at the same time is one of other joints; name the group of this one", field="group"
            )
        names = robot.descriptor.joints
        for name in message.joint_names:
            if name not in names:
                raise InvalidRequest(f"{name} is none of the joints {', '.join(names)}", field="concurrent.joint_names")
        given = TimedTrajectory.of(message, message.joint_names)
        moving = np.flatnonzero(np.ptp(given.position, axis=0) > _UNMOVED_TOLERANCE)
        indices = np.array([names.index(message.joint_names[k]) for k in moving], np.intp)
        for index in indices.tolist():
            if index in group.joints:
                raise InvalidRequest(
                    f"{names[index]} moves there already, and is of the group {', '.join(group.names)}",
                    field="concurrent.joint_names",
                )
        rows = (given.position, given.velocity, given.acceleration)
        return cls(indices, TimedTrajectory(given.time - given.begin, *(each[:, moving] for each in rows)))

    def shifted(self, turns: Array) -> Self:
        """The same after whole turns (dof,) in rad of continuous joints."""
        return replace(self, motion=self.motion.shifted(turns[self.joints]))

    def at(self, q: Array, *, end: bool = False) -> Array:
        """Joints (dof,) of the robot with these where they begin, or where they end."""
        placed = q.copy()
        placed[self.joints] = self.motion.end if end else self.motion.start
        return placed

    def plan(
        self, group: Group, planner: Planner, context: PlanningContext, start: Array, goal: Goal, full: Limits
    ) -> Verified:
        """A motion of all joints, from `start` (dof,): these do what they do, inside the limits `full`, and the group goes to its goal.

        Raises what `Group.plan` raises, and PlanningFailed (`no_path`) if the two are never apart.
        """
        planned = group.plan(planner, context, self.at(start, end=True), goal, None)
        limits = self._limits(context.limits, full)
        begin = self.at(start)
        latest = self.motion.duration
        try:
            sequential, base = self._verified(context, limits, begin, group, planned.trajectory, latest)
        except VerificationFailed as failure:
            raise PlanningFailed(
                f"the motion is not free after the one at the same time: {failure}; {failure.remedy}", code="no_path"
            ) from failure
        together, clearance, delay = sequential, base, latest
        for tried in np.linspace(0.0, latest, _STARTS, endpoint=False).tolist():
            context.deadline.check()
            try:
                found, apart = self._verified(context, limits, begin, group, planned.trajectory, tried)
            except VerificationFailed:
                continue
            if apart >= min(base, context.scene.self_margin):
                together, clearance, delay = found, apart, tried
                break
        nearer: tuple[TooNear, ...] = ()
        if clearance < max(context.world.margin, context.scene.self_margin):
            nearer = too_near(context.scene, together, clearance, context.deadline.check)
        return replace(
            planned.begun_at(delay),
            trajectory=together,
            clearance=clearance,
            too_near=nearer,
            waypoint_times=tuple(delay + time for time in planned.waypoint_times),
        )

    def _limits(self, scaled: Limits, full: Limits) -> Limits:
        """The scaled limits of a request, full for these joints, which are under way."""
        own = np.isin(np.arange(len(full.joints)), self.joints)
        return replace(
            scaled,
            velocity=np.where(own, full.velocity, scaled.velocity),
            acceleration=np.where(own, full.acceleration, scaled.acceleration),
            jerk=np.where(own, full.jerk, scaled.jerk),
        )

    def _verified(
        self,
        context: PlanningContext,
        limits: Limits,
        begin: Array,
        group: Group,
        motion: TimedTrajectory,
        delay: float,
    ) -> tuple[TimedTrajectory, float]:
        """Both motions, that of the group after a `delay` (s), and how far (m) all stay apart. Raises VerificationFailed."""
        together = self._with(begin, group, motion, delay)
        clearance = verify(
            together,
            together.start,
            together.end,
            limits,
            context.exact,
            context.deadline.check,
            motion=together.states[1:, 0],
        )
        _check_torque(context, together)
        return together, clearance

    def _with(self, begin: Array, group: Group, motion: TimedTrajectory, delay: float) -> TimedTrajectory:
        """Both motions as one, from `begin` (dof,); a piece of a quintic is a quintic, so neither changes."""
        times = np.unique(np.concatenate([[0.0], self.motion.time, [delay], delay + motion.time]))
        times = times[np.append(True, np.diff(times) > 2.0 * MIN_INTERVAL)]
        states = np.zeros((3, len(times), len(begin)))
        states[0] = begin
        for joints, part, late in ((self.joints, self.motion, 0.0), (group.joints, motion, delay)):
            columns = slice(None) if part is self.motion else joints
            at = part.sample(np.clip(times - late, 0.0, part.duration))[:, :, columns]
            at[1:, times > late + part.duration] = 0.0
            states[:, :, joints] = at
        return TimedTrajectory(times, *states)


def _check_torque(context: PlanningContext, motion: TimedTrajectory) -> None:
    """Raises VerificationFailed if a joint would need more than its largest torque."""
    dynamics = context.scene.exact.model.dynamics
    if dynamics is None:
        return
    times = np.linspace(0.0, motion.duration, 2 + int(motion.duration / _TORQUE_STEP))
    share = np.abs(dynamics.torque(*motion.sample(times))) / dynamics.limit
    sample, joint = np.unravel_index(share.argmax(), share.shape)
    if share[sample, joint] > 1.0:
        raise VerificationFailed(
            f"{context.limits.joints[joint]} would need {share[sample, joint]:.2f} of its effort at {times[sample]:.2f} s",
            float(times[sample]),
        )
