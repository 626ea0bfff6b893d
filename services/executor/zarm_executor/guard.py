"""The authority of a goal: how far the servo lets it go, and whether there is a servo.

The servo repeatedly states up to which path time a goal may go in one scene. If that is not the present scene, it can
only hold the goal back. A servo that is silent, or checks in an old scene, for `guard_timeout` guards nothing.
"""

from __future__ import annotations

import math

from zarm_contract.descriptor import RobotDescriptor
from zarm_contract.errors import Problem
from zarm_contract.messages import Authority, Hold, Obstruction, SceneRevision
from zarm_trajectory.follower import Follower
from zarm_trajectory.path_state import PathState
from zarm_trajectory.rate_bounds import RateLimits
from zarm_trajectory.trajectory import TimedTrajectory

LEAST_WAY = 0.1
"""A held goal resumes only when it may go at least this much further (s of path time), not millimetre by millimetre."""
_TICKS = 2
"""Ticks until a stop takes effect."""
_LOOK_AHEAD = 0.1
"""Look-ahead (s) of the test whether the robot could still stop in time, so that not every tick has to repeat it."""
_POINT = 0.1
"""Time step (s) of the braking computation."""


class Limit:
    """The end of an authority: the robot, led by `follower`, must come to rest before the path time `until` (s)."""

    def __init__(self, follower: Follower, until: float, obstruction: Obstruction | None) -> None:
        self.until = until
        self.obstruction = obstruction
        self._follower = follower
        self._free = PathState(-math.inf, 0.0)

    def must_brake(self, state: PathState, reaction: float) -> bool:
        """Whether a robot in this state must brake now, because `reaction` s later it could no longer stop in time.

        If it could still stop in time from a little further on, the test is skipped until it gets there.
        """
        soon = state.after(reaction)
        if state.speed == 0.0 or (
            soon.time < self._free.time and state.speed <= self._free.speed and state.rate <= 0.0
        ):
            return False
        further = soon.after(_LOOK_AHEAD)
        if state.rate == 0.0 and self._rest(further) < self.until:
            self._free = further
            return False
        return self._rest(soon) >= self.until

    def hold(self, state: PathState) -> Hold:
        """The hold of a robot that brakes from this state."""
        found = self.obstruction
        if found is not None:
            found = found.model_copy(update={"avoidable": self._rest(state) <= found.time})
        return Hold(reason="obstruction", obstruction=found)

    def _rest(self, state: PathState) -> float:
        """The path time (s) at which a robot braking from this state comes to rest."""
        return self._follower.rest(state, _POINT)[1]


class Guard:
    """What the servo said last. Times are on the monotonic clock; one call at a time, except for `limit`."""

    def __init__(self, descriptor: RobotDescriptor) -> None:
        execution = descriptor.execution
        self.required = execution.guard == "required"
        self.timeout = execution.guard_timeout
        self.patience = execution.obstruction_timeout
        self._reaction = _TICKS * execution.control_period
        self._limits = RateLimits.of(descriptor)
        self._newest: Authority | None = None
        self._received_at = self._confirmed_at = -math.inf

    def receive(self, authority: Authority, now: float) -> bool:
        """Note an authority; returns whether it is newer than the last one."""
        before = self._newest
        if before is not None and before.servo == authority.servo and authority.sequence <= before.sequence:
            return False
        self._newest, self._received_at = authority, now
        return True

    def of(self, goal_id: str) -> Authority | None:
        """The last authority, if it is for this goal."""
        newest = self._newest
        return newest if newest is not None and newest.goal_id == goal_id else None

    def confirm(self, goal_id: str | None, scene: SceneRevision | None, now: float) -> bool:
        """Whether the robot is guarded, with this goal or none, in this scene; asked at every tick."""
        if self.checked(goal_id, scene, now):
            self._confirmed_at = self._received_at
        return now - self._confirmed_at <= self.timeout

    def checked(self, goal_id: str | None, scene: SceneRevision | None, now: float) -> bool:
        """Whether the last authority is for this goal in exactly this scene, and not old."""
        newest = self._newest
        return (
            newest is not None
            and (newest.goal_id, newest.scene_revision) == (goal_id, scene)
            and now - self._received_at <= self.timeout
        )

    def limit(
        self, trajectory: TimedTrajectory, until: float | None, obstruction: Obstruction | None = None
    ) -> Limit | None:
        """The end of an authority over this trajectory up to the path time `until` (s); None if it reaches the end."""
        if until is None or until >= trajectory.duration:
            return None
        return Limit(Follower(trajectory, self._limits), until, obstruction)

    def must_brake(self, limit: Limit, state: PathState) -> bool:
        """Whether a robot that would brake from this state must do so now."""
        return limit.must_brake(state, self._reaction)


def given_up(hold: Hold, patience: float) -> Problem:
    """The problem with which a goal ends that was held for `patience` s."""
    found = hold.obstruction
    if hold.reason == "no_guard":
        return Problem(
            code="unavailable",
            message=f"the goal was held for {patience:g} s because no servo guards it and execution.guard is required; start "
            "the servo, then plan again from where the robot is",
        )
    what = "something" if found is None else found.object
    where = "" if found is None else f" of {found.link} at {found.time:.2f} s of the trajectory"
    return Problem(
        code="stale_plan",
        message=f"{what} is in the way{where}, and has been for {patience:g} s (execution.obstruction_timeout); remove it, or "
        "plan again from where the robot is",
    )
