"""Executes a goal tick by tick, from its start until the robot is at rest."""

from __future__ import annotations

import logging
from collections import deque
from dataclasses import replace

from zarm_contract.errors import Busy, ExecutionFailed, ExecutionRefused, Unavailable, ZarmError
from zarm_contract.messages import Authority, GoalState, Hold, Openings, RobotMode, SceneRevision
from zarm_executor.goal import Chunk, Goal, Joined
from zarm_executor.guard import LEAST_WAY, Guard, Limit, given_up
from zarm_executor.lag import Lag
from zarm_executor.monitor import Monitor
from zarm_executor.states import (
    Accepted,
    Ended,
    Ending,
    Held,
    Outcome,
    Paused,
    Pausing,
    Running,
    State,
    held_of,
    hold_of,
    mode_of,
    outcome_of,
    status_of,
    with_held,
)
from zarm_executor.strategies.base import Measured, Progress, Steerable, Strategy
from zarm_trajectory.blending import blended, continued
from zarm_trajectory.limits import Limits
from zarm_trajectory.path_state import PathState
from zarm_trajectory.trajectory import TimedTrajectory

log = logging.getLogger(__name__)

_MOVING = (Accepted, Running)
"""The states in which the robot moves along the trajectory. A tuple, because a union costs time in every tick."""
_SETTLED = (*_MOVING, Paused)
"""The states in which the robot need not come to rest."""


class GoalExecution:
    """Executes one goal: `strategy` moves the robot along its path, and each new state of the goal is appended to
    `changes`.

    One call at a time. Raises Unavailable for a stream if the strategy cannot follow one.
    """

    def __init__(self, goal: Goal, strategy: Strategy, guard: Guard, changes: deque[GoalState]) -> None:
        self.goal = goal
        self._strategy = strategy
        self._guard = guard
        self._state: State = Accepted()
        self._elapsed = 0.0
        self._lag = Lag()
        self._held_until = 0.0
        self._limit: Limit | None = None
        self._speed_scale = 1.0
        self._changes = changes
        self._joints_reported = True
        self._failures: list[ExecutionFailed] = []
        self._stops = deque(goal.stops)
        self._stop_begun = False  # the first of them
        self._stop_limit = self._next_stop()
        if goal.chunk is not None:
            self._steerable()

    # -- commands --

    def start(self, speed_scale: float) -> None:
        """Start to move the robot, which is at the start of the path. Raises what the strategy raises."""
        self._speed_scale = speed_scale
        self._strategy.start(self.goal.trajectory, speed_scale)
        self._note()

    def permit(self, authority: Authority, limit: Limit | None, scene: SceneRevision | None) -> None:
        """Take an authority of the servo, whose end is `limit`. If it is for a scene other than `scene`, it can only
        hold the goal back.
        """
        if authority.trajectory == self.goal.number:
            nearer = limit is not None and (self._limit is None or limit.until < self._limit.until)
            if nearer or authority.scene_revision == scene:
                self._limit = limit

    def end(self, outcome: Outcome) -> None:
        """Bring the robot to rest, and then end the goal with this outcome."""
        self._strategy.stop()
        if self._stop_begun:
            self._stops[0].cancel("the goal of the robot ended")
        self._enter(Ending(outcome, held_of(self._state)))

    def fail(self, failure: ExecutionFailed) -> None:
        """Bring the robot to rest, and then end the goal in a fault."""
        self._failures.append(failure)
        self.end(Outcome.fault_of(self._failures, self.goal.monitor.faults))

    def pause(self) -> None:
        """Bring the robot to rest and hold it; no effect on a goal that is ending."""
        if self.outcome is None:
            if not isinstance(self._state, Paused):
                self._enter(Pausing(held_of(self._state)))
            self._strategy.stop()

    def resume(self, speed_scale: float, scene: SceneRevision | None, now: float) -> None:
        """Resume where the goal was paused, as far as its authority reaches.

        Raises ExecutionRefused (`stale_plan`) if its scene is not the present one, `scene`, and the servo has not
        checked the rest of it in that scene.
        """
        goal = self.goal
        if isinstance(self._state, Pausing | Paused):
            if goal.scene != scene and not self._guard.checked(goal.goal_id, scene, now):
                raise ExecutionRefused(
                    f"the scene is not the one that {goal.goal_id} started in (revision {goal.scene}, now {scene}), so "
                    "the rest of it may collide; it stays paused: cancel it, and plan again from where the robot is",
                    code="stale_plan",
                )
            held = self._state.held
            goal.monitor.go_on()
            self._speed_scale = speed_scale
            self._enter(Running() if held is None else replace(held, since=now))
            if held is None and not self._blocked(now):
                self._strategy.move(speed_scale)

    def set_speed(self, speed_scale: float) -> None:
        """Move at this share of the planned speed, unless the goal is held or ending."""
        self._speed_scale = speed_scale
        if self._moving:
            self._strategy.move(speed_scale)

    def steer(self, chunk: Chunk, limits: Limits) -> None:
        """Blend over to this chunk; no effect if the goal is not a stream, has its last chunk, or is ending.

        Raises what `blended` raises.
        """
        goal = self.goal
        if self.outcome is None and not goal.complete:
            strategy = self._steerable()
            trajectory = blended(goal.trajectory, strategy.commanded(), chunk.trajectory, chunk.start, limits)
            self.goal = goal.steered(trajectory, chunk)
            strategy.steer(trajectory)

    def replace(
        self,
        trajectory: TimedTrajectory,
        at: float,
        verified: SceneRevision,
        openings: Openings,
        until: float | None = None,
        *,
        joined: Joined | None = None,
    ) -> None:
        """Continue along `trajectory`, verified in that scene with these openings of grippers, from the path time `at` (s) on; this
        releases a held goal. `joined` as in `Goal.replaced`.

        The robot may go up to the time `until` (s) of `trajectory`, or to its end if None.

        Raises Busy if the goal is pausing or ending, or a stream, Unavailable if the strategy cannot follow it, ExecutionRefused
        (`start_state_mismatch`) if it is too late for `at`, and what `continued` raises.
        """
        self._demand_no_end()
        if self.goal.chunk is not None:
            raise Busy(f"{self.goal.goal_id} is led chunk by chunk, so nothing can take over from it; let it end first")
        strategy = self._steerable()
        earliest = strategy.braking_from().time
        if at < earliest:
            raise ExecutionRefused(
                f"the trajectory takes over at {at:.3f} s, but the robot is committed until {earliest:.3f} s; plan from a "
                "later state",
                code="start_state_mismatch",
            )
        whole = continued(self.goal.trajectory, strategy.commanded(), trajectory, at)
        self.goal = self.goal.replaced(whole, verified, openings, joined=joined)
        strategy.steer(whole)
        self._go_on(at, until)

    def replace_at_rest(
        self,
        trajectory: TimedTrajectory,
        monitor: Monitor,
        verified: SceneRevision,
        openings: Openings,
        until: float | None = None,
    ) -> None:
        """Continue along `trajectory`, verified in that scene with these openings of grippers, from where the robot rests, held by its
        authority; `monitor` watches it.

        The robot may go up to the time `until` (s) of `trajectory`, or to its end if None.

        Raises Busy if the robot is not at rest in this way, and what the strategy raises.
        """
        self._demand_no_end()
        held, time = self._state, self._strategy.progress().time
        if not isinstance(held, Held) or not held.at_rest:
            raise Busy(
                f"{self.goal.goal_id} is not waiting at rest for an obstruction to clear; say from when on to replace its trajectory"
            )
        self._strategy.admit()
        trajectory = trajectory.begun_at(time)
        self._strategy.start(trajectory, self._speed_scale)
        self.goal = self.goal.replaced(trajectory, verified, openings, monitor)
        if held.hold.reason == "no_guard":
            self._strategy.stop()
        self._go_on(time, until)

    def _demand_no_end(self) -> None:
        if isinstance(self._state, Pausing | Paused | Ending | Ended):
            raise Busy(f"{self.goal.goal_id} is ending or pausing, so its trajectory cannot be replaced")

    def _go_on(self, begin: float, until: float | None) -> None:
        """Take the new trajectory, which begins at the path time `begin` (s), as free up to its time `until` (s), or to
        its end if None.
        """
        goal = self.goal
        self._limit = self._guard.limit(goal.trajectory, None if until is None else begin + until)
        if isinstance(self._state, Held) and self._state.hold.reason == "obstruction":
            self._state = Running()
            goal.monitor.go_on()
            self._strategy.move(self._speed_scale)
        log.info("the goal has a new trajectory goal_id=%s number=%d", goal.goal_id, goal.number)
        self._note()

    def _steerable(self) -> Steerable:
        if not isinstance(self._strategy, Steerable):
            raise Unavailable(
                f"under {self._strategy.name} a motion is handed over as a whole, so it cannot be streamed or replaced; switch to "
                "another strategy first (executor/strategy)"
            )
        return self._strategy

    # -- state --

    def state(self) -> GoalState:
        """The goal's current state."""
        return self.goal.state(self._strategy.progress(), self._state, self._elapsed, self._lag.seconds)

    @property
    def mode(self) -> RobotMode:
        """The robot mode that follows from the goal."""
        return mode_of(self._state)

    @property
    def outcome(self) -> Outcome | None:
        """How the goal ends, once that is certain."""
        return outcome_of(self._state)

    @property
    def _moving(self) -> bool:
        return isinstance(self._state, _MOVING)

    def _enter(self, state: State) -> None:
        """Change the state, and publish it if it looks different."""
        before, self._state = self._state, state
        if status_of(before) != status_of(state) or hold_of(before) is not hold_of(state):
            self._note()

    # -- the control loop --

    def advance(self, now: float, dt: float, *, guarded: bool) -> Outcome | None:
        """Evaluate `dt` s of control, up to `now` on the monotonic clock; returns the goal's outcome once it has ended.

        `guarded`: a servo watches it.
        """
        goal, progress, measured = self.goal, self._strategy.progress(), self._strategy.joint_state()
        self._lag.observe(now, dt, progress.command, measured)
        held = held_of(self._state)
        if not isinstance(self._state, Paused) and (held is None or not held.at_rest):
            self._elapsed += dt
        if isinstance(self._state, Accepted):
            self._enter(Running())
        try:
            if self.outcome is None:
                if (reason := self._strategy.problem()) is not None:
                    raise ExecutionFailed(f"the driver gave up the motion: {reason}", code="driver_stalled")
                self._note_joint_reports(goal.monitor.follow(now, dt, progress, measured, self._strategy.pace()))
                self._apply_authority(now, progress, guarded=guarded)
            if self._moving:
                late = goal.late(now, self._held_until)
                if late is not None:
                    self.end(Outcome("aborted", late))
                elif self._joints_reported and goal.complete:
                    if goal.monitor.at_goal(now, progress, measured):
                        return self._finish(Outcome("succeeded"))
                    missed = goal.monitor.missed(now, progress, measured)
                    if missed is not None:
                        return self._finish(Outcome("aborted", missed))
            else:
                self._held_until = now
        except ExecutionFailed as failure:
            self.fail(failure)
        state = self._state
        if isinstance(state, _SETTLED) or (isinstance(state, Held) and state.at_rest):
            return None
        return self._come_to_rest(now, progress, measured)

    def _note_joint_reports(self, seen: bool) -> None:
        """Note whether the robot's joints are reported, and log when that changes."""
        if seen and not self._joints_reported:
            log.warning("the robot's joints are reported again goal_id=%s", self.goal.goal_id)
        elif self._joints_reported and not seen:
            log.warning("the robot is held, its joints are not reported goal_id=%s", self.goal.goal_id)
        self._joints_reported = seen

    def _come_to_rest(self, now: float, progress: Progress, measured: Measured | None) -> Outcome | None:
        try:
            if not self.goal.monitor.at_rest(now, progress, measured):
                return None
        except ExecutionFailed as failure:
            self.fail(failure)  # the time allowed for stopping is over; the strategy keeps commanding the stop
        match self._state:
            case Ending(outcome, _):
                return self._finish(outcome)
            case Pausing(held):
                self._enter(Paused(held))
            case Held():
                self._state = replace(self._state, at_rest=True)
        return None

    def _apply_authority(self, now: float, progress: Progress, *, guarded: bool) -> None:
        """Brake at the end of the authority or without a required servo; continue when that is over, or give up after a
        while.
        """
        held = held_of(self._state)
        if held is None:
            if not guarded and self._guard.required:
                self._hold(Hold(reason="no_guard"), now, progress.time)
            elif self._moving and not progress.finished:
                self._brake_in_time(now)
        elif self._stops and held.hold is self._stops[0].hold:
            self._act(held, now)
        elif self._free(held, progress, guarded=guarded):
            self._continue(now, finished=progress.finished)
        elif isinstance(self._state, Held) and now - held.since > self._guard.patience:
            self.end(Outcome("aborted", given_up(held.hold, self._guard.patience)))
        else:
            self._update_obstruction(held)

    def _continue(self, now: float, *, finished: bool) -> None:
        """Go on from a hold, as far as the authority reaches."""
        log.info("the goal continues goal_id=%s", self.goal.goal_id)
        if isinstance(self._state, Held):
            self.goal.monitor.go_on()
            if not finished:
                if self._blocked(now):
                    return
                self._strategy.move(self._speed_scale)
        self._enter(with_held(self._state, None))

    def _next_stop(self) -> Limit | None:
        return self._guard.limit(self.goal.trajectory, self._stops[0].until) if self._stops else None

    def _act(self, held: Held, now: float) -> None:
        """At rest, have the gripper move, or the output switched; go on when that is done, or end the goal with the reason."""
        if not isinstance(self._state, Held) or not held.at_rest:
            return
        stop, goal_id = self._stops[0], self.goal.goal_id
        try:
            if not self._stop_begun:
                stop.begin(goal_id)
                self._stop_begun = True
            if stop.moving:
                return
        except ZarmError as error:
            self.end(Outcome("aborted", error.problem))
            return
        self._stop_begun = False
        if (problem := stop.problem(goal_id)) is not None:
            self.end(Outcome("aborted", problem))
            return
        self._stops.popleft()
        self._stop_limit = self._next_stop()
        self._continue(now, finished=False)

    def _update_obstruction(self, held: Held) -> None:
        """Update the hold if another obstacle is now in the way."""
        before, found = held.hold.obstruction, None if self._limit is None else self._limit.obstruction
        if before is not None and found is not None and (before.object, before.link) != (found.object, found.link):
            hold = held.hold.model_copy(update={"obstruction": found})
            self._enter(with_held(self._state, replace(held, hold=hold)))

    def _brake_in_time(self, now: float) -> None:
        state: PathState | None = None
        for limit in (self._limit, self._stop_limit):
            if limit is not None:
                state = state or self._strategy.braking_from()
                if self._guard.must_brake(limit, state):
                    stops = limit is self._stop_limit
                    self._hold(self._stops[0].hold if stops else limit.hold(state), now, limit.until)
                    return

    def _blocked(self, now: float) -> bool:
        """Hold a goal at rest whose authority ends here; returns whether it does."""
        limit, time = self._limit, self._strategy.braking_from().time
        blocked = limit is not None and limit.until < time + LEAST_WAY
        if limit is not None and blocked:
            self._hold(limit.hold(PathState(time, 0.0)), now, time)
        return blocked

    def _free(self, held: Held, progress: Progress, *, guarded: bool) -> bool:
        """Whether the reason for the hold is gone."""
        if not guarded and self._guard.required:
            return False
        if held.hold.reason == "no_guard":
            return True
        further = self._limit is None or self._limit.until >= held.at + LEAST_WAY
        return further or (progress.finished and progress.at_rest)

    def _hold(self, hold: Hold, now: float, at: float) -> None:
        goal, found = self.goal, hold.obstruction
        self._strategy.stop()
        self._enter(with_held(self._state, Held(hold, now, at)))
        if self._stops and hold is self._stops[0].hold:
            log.info("the goal waits for its %s goal_id=%s", hold.reason, goal.goal_id)
        elif found is None:
            log.warning("the goal is held goal_id=%s reason=%s", goal.goal_id, hold.reason)
        else:
            log.warning(
                "the goal is held goal_id=%s object=%s link=%s time=%.2f avoidable=%s",
                goal.goal_id,
                found.object,
                found.link,
                found.time,
                found.avoidable,
            )

    def _finish(self, outcome: Outcome) -> Outcome:
        self._enter(Ended(outcome))
        return outcome

    def _note(self) -> None:
        self._changes.append(self.state())
