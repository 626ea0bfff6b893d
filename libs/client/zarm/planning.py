"""Plans of a robot: goals into verified motions."""

from __future__ import annotations

import secrets
from contextlib import suppress
from typing import TYPE_CHECKING, TypedDict, Unpack

from zarm.calls import Calls
from zarm.connection import ANSWER_SECONDS
from zarm.values import Goal, goal_of, joints_of, made
from zarm_contract.errors import Unavailable
from zarm_contract.messages import (
    CancelPlan,
    PathConstraint,
    Plan,
    PlannerKind,
    PlannerSettings,
    PlanRequest,
    SettingsChange,
    StartState,
)

if TYPE_CHECKING:
    from zarm.values import Numbers

LONGEST_PLANNING = 60.0
"""s, the planner's maximum."""


class Settings(TypedDict, total=False):
    """Default options of plans; `Robot.plan` explains each."""

    planner: PlannerKind
    timeout: float
    max_attempts: int
    optimize_s: float
    velocity_scale: float
    acceleration_scale: float
    margin: float


class Planning(Calls):
    """Plans, and their default options."""

    def plan(
        self,
        goal: Goal,
        *,
        start: Numbers | StartState | None = None,
        path_constraint: PathConstraint | None = None,
        planner: PlannerKind | None = None,
        timeout: float | None = None,
        max_attempts: int | None = None,
        optimize_s: float | None = None,
        velocity_scale: float | None = None,
        acceleration_scale: float | None = None,
        margin: float | None = None,
        self_margin: float | None = None,
        seed: int = 0,
    ) -> Plan:
        """A verified motion to a `zarm.Pose`, to joint positions (rad), to one of several poses (`zarm.AnyOf`), or
        through `zarm.Waypoints`. Nothing moves.

        `start` is a list of joint positions (rad), by default the measured ones, or a `zarm.StartState` in motion, from
        which the plan continues in position, velocity and acceleration. `timeout` (s) is the deadline, and
        `max_attempts` the number of searches after which the planner gives up earlier. For `optimize_s` s after the
        first motion is found, the planner looks for faster ones. The scales (above 0, up to 1) are fractions of the
        joint limits. `margin` (m) is the distance to objects on the way, and `self_margin` (m) the distance between the
        robot's own links, by default the descriptor's. Options that are left out come from `settings`. With
        `optimize_s` 0, the same request, seed and scene give the same motion.

        Ctrl-C ends the planning. Raises PlanningFailed, DeadlineExceeded or InvalidRequest.
        """
        return self.request_plan(
            made(
                PlanRequest,
                goal=goal_of(goal),
                start=None if isinstance(start, StartState) else joints_of(start, "start"),
                start_state=start if isinstance(start, StartState) else None,
                path_constraint=path_constraint,
                planner=planner,
                timeout=timeout,
                max_attempts=max_attempts,
                optimize_s=optimize_s,
                velocity_scale=velocity_scale,
                acceleration_scale=acceleration_scale,
                margin=margin,
                self_margin=self_margin,
                seed=seed,
            )
        )

    def request_plan(self, request: PlanRequest) -> Plan:
        """`plan` with a message; it gets a new `request_id` if it has none."""
        named = request.model_copy(update={"request_id": request.request_id or f"plan-{secrets.token_hex(8)}"})
        timeout = (request.timeout or LONGEST_PLANNING) + ANSWER_SECONDS
        try:
            return self._ask(self._keys.plan, named, timeout=timeout)
        except KeyboardInterrupt:
            with suppress(Unavailable):
                self.cancel_plan(named.request_id or "")
            raise

    def cancel_plan(self, request_id: str, *, timeout: float = ANSWER_SECONDS) -> bool:
        """Cancel a planning request by its `request_id`, even before it arrives. Returns whether it was running."""
        request = CancelPlan(request_id=request_id)
        return self._ask(self._keys.plan_cancel, request, timeout=timeout).was_running

    def settings(self, /, **changes: Unpack[Settings]) -> PlannerSettings:
        """Default options of plans, after these changes: `settings(margin=0.01)`."""
        if not changes:
            return self.connection.read(self._keys.settings)
        return self._ask(self._keys.settings, made(SettingsChange, **changes))
