"""The planner of a robot: goals into verified motions, their default options, and kinematics."""

from __future__ import annotations

import secrets
from collections.abc import Mapping, Sequence
from contextlib import suppress
from typing import TYPE_CHECKING, TypedDict, TypeVar, Unpack

from zarm.connection import ANSWER_SECONDS
from zarm.kinematics import Kinematics
from zarm.motions import Goal, goal_of
from zarm.values import joints_of, made
from zarm_contract.errors import Unavailable
from zarm_contract.key import Query
from zarm_contract.messages import (
    CancelPlan,
    GripperOpening,
    PathConstraint,
    Plan,
    PlannerKind,
    PlannerSettings,
    PlanRequest,
    ProgramRequest,
    Segment,
    SettingsChange,
    StartState,
    Trajectory,
)

if TYPE_CHECKING:
    from zarm.values import Numbers

Asked = TypeVar("Asked", PlanRequest, ProgramRequest)

LONGEST_PLANNING = 60.0
"""s, the planner's maximum."""


class Settings(TypedDict, total=False):
    """Default options of plans; `PlanOptions` explains each."""

    planner: PlannerKind | None
    timeout: float | None
    max_attempts: int | None
    optimize_s: float | None
    velocity_scale: float | None
    acceleration_scale: float | None
    margin: float | None


class PlanOptions(Settings, total=False):
    """Options of one plan. Those that are left out, or None, come from the planner's `settings`.

    `start` is a list of joint positions (rad), by default the measured ones, or a `zarm.StartState` in motion, from
    which the plan continues in position, velocity and acceleration. `path_constraint` holds axes of the tip. `planner`
    names the planner. `timeout` (s) is the deadline, and `max_attempts` the number of searches after which the planner
    gives up earlier. For `optimize_s` s after the first motion is found, the planner looks for faster ones. The scales
    (above 0, up to 1) are fractions of the joint limits. `margin` (m) is the distance to objects on the way, and
    `self_margin` (m) the distance between the robot's own links, by default the descriptor's. With `optimize_s` 0, the
    same request, `seed` (default: 0) and scene give the same motion. `openings` (m) are those of grippers by name, by default the
    measured ones. Only the joints of a `group` move: joint positions as a goal are then its own, and poses those of its
    tip; `start` is always that of the whole robot. `concurrent` is a motion of other joints at the same time, a plan or a trajectory: the
    plan then has both, and the group starts as soon as all stay apart.
    """

    start: Numbers | StartState | None
    path_constraint: PathConstraint | None
    self_margin: float | None
    seed: int
    openings: Mapping[str, float] | None
    group: str | None
    concurrent: Plan | Trajectory | None


class Planner(Kinematics):
    """Plans, their default options, and kinematics."""

    def plan(self, goal: Goal, **options: Unpack[PlanOptions]) -> Plan:
        """A verified motion to a `zarm.Pose`, to joint positions (rad), to one of several poses (`zarm.AnyOf`), or
        through `zarm.Waypoints`. Nothing moves.

        A robot with several arms moves them together to `{"left": pose, "right": pose}`, and one of them with `group`.

        `options` are `start`, `path_constraint`, `planner`, `timeout`, `max_attempts`, `optimize_s`, `velocity_scale`,
        `acceleration_scale`, `margin`, `self_margin`, `seed`, `openings`, `group` and `concurrent`: see `zarm.PlanOptions`.

        Ctrl-C ends the planning. Raises PlanningFailed, DeadlineExceeded or InvalidRequest.
        """
        return self.request_plan(plan_request(goal, **options))

    def request_plan(self, request: PlanRequest) -> Plan:
        """`plan` with a message; it gets a new `request_id` if it has none."""
        return self._answered(self._keys.plan, request)

    def _answered(self, key: Query[Asked, Plan], request: Asked) -> Plan:
        """The planner's answer; Ctrl-C ends the planning."""
        named = request.model_copy(update={"request_id": request.request_id or f"plan-{secrets.token_hex(8)}"})
        timeout = (request.timeout or LONGEST_PLANNING) + ANSWER_SECONDS
        try:
            return self._ask(key, named, timeout=timeout)
        except KeyboardInterrupt:
            with suppress(Unavailable):
                self.cancel_plan(named.request_id or "")
            raise

    def plan_program(self, segments: Sequence[Segment], /, **options: Unpack[ProgramOptions]) -> Plan:
        """One verified motion through all segments: `zarm.Move`, `zarm.Wait`, `zarm.Grip`, `zarm.SetOutput`, `zarm.Attach`,
        `zarm.Detach`, `zarm.SpeedChange`.

        `plan.segments` says when each begins. What a program attaches or detaches changes in the scene when the robot gets there.
        The options mean what they do in `plan`. Raises what `plan` raises; the error names the segment.
        """
        fields: dict[str, object] = {**options}
        fields["start"] = joints_of(options.get("start"), "start")
        fields["openings"] = _openings(options.get("openings"))
        return self.request_program(made(ProgramRequest, segments=tuple(segments), **fields))

    def request_program(self, request: ProgramRequest) -> Plan:
        """`plan_program` with a message; it gets a new `request_id` if it has none."""
        return self._answered(self._keys.program, request)

    def cancel_plan(self, request_id: str, *, timeout: float = ANSWER_SECONDS) -> bool:
        """Cancel a planning request by its `request_id`, even before it arrives. Returns whether it was running."""
        request = CancelPlan(request_id=request_id)
        return self._ask(self._keys.plan_cancel, request, timeout=timeout).was_running

    def settings(self, /, **changes: Unpack[Settings]) -> PlannerSettings:
        """Default options of plans, after these changes: `settings(margin=0.01)`."""
        if not changes:
            return self.connection.read(self._keys.settings)
        return self._ask(self._keys.settings, made(SettingsChange, **changes))


class ProgramOptions(TypedDict, total=False):
    """Options of a program; see `PlanOptions`."""

    start: Numbers | None
    request_id: str | None
    timeout: float | None
    max_attempts: int | None
    velocity_scale: float | None
    acceleration_scale: float | None
    margin: float | None
    self_margin: float | None
    seed: int
    publish: bool
    partial: bool
    openings: Mapping[str, float] | None


def plan_request(goal: Goal, **options: Unpack[PlanOptions]) -> PlanRequest:
    """The request for a plan with these options. Raises InvalidRequest that names the field at fault."""
    fields: dict[str, object] = {**options}
    start = options.get("start")
    if isinstance(start, StartState):
        fields.update(start=None, start_state=start)
    else:
        fields["start"] = joints_of(start, "start")
    fields["openings"] = _openings(options.get("openings"))
    beside = options.get("concurrent")
    fields["concurrent"] = beside.trajectory if isinstance(beside, Plan) else beside
    return made(PlanRequest, goal=goal_of(goal), **fields)


def _openings(openings: Mapping[str, float] | None) -> tuple[GripperOpening, ...]:
    return tuple(made(GripperOpening, gripper=name, width=width) for name, width in (openings or {}).items())
