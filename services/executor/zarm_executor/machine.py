"""The state machine that owns the robot: who may move it, one goal at a time.

`transitions.py` holds the modes, and what leads from one to another; `states.py` the states of a goal.

The machine knows neither bus nor clock nor files: commands come from any thread, `tick` from the control loop, and changes
wait in `changes` until they are published.

Several threads carry out commands, so each has an `arrival`; `command_order.py` says which commands win over which.
"""

from __future__ import annotations

import logging
import math
import threading
from collections import deque

from zarm_contract.errors import Busy, Cancelled, ExecutionFailed, ExecutionRefused, Problem, Unavailable
from zarm_contract.messages import (
    Authority,
    ExecutorState,
    ExternalTorque,
    GoalState,
    Openings,
    RobotMode,
    SceneRevision,
)
from zarm_executor.command_order import CommandOrder
from zarm_executor.goal import Chunk, Goal, Joined
from zarm_executor.goal_execution import GoalExecution
from zarm_executor.guard import Guard
from zarm_executor.monitor import Monitor
from zarm_executor.states import Outcome
from zarm_executor.strategies.base import Measured, Strategy
from zarm_executor.switching import ActiveStrategy
from zarm_executor.tick_clock import TickClock
from zarm_executor.withdrawals import Withdrawals
from zarm_runtime import clock
from zarm_trajectory.limits import Limits
from zarm_trajectory.trajectory import TimedTrajectory

log = logging.getLogger(__name__)

STALL_LIMIT = 1.0
"""If the control loop stands still for longer than this (s) while the robot moves, the motion ends in `fault`."""


class Machine:
    """See the module. `strategy` is opened here, which may raise its ZarmError. `period` (s) is that of the control
    loop, `speed_scale` the speed of the first motion.

    `scene` is the last known scene revision, None before the first.
    """

    def __init__(self, strategy: Strategy, period: float, guard: Guard, *, speed_scale: float = 1.0) -> None:
        self._active = ActiveStrategy(strategy)
        self._clock = TickClock(period)
        self._order = CommandOrder()
        self._withdrawals = Withdrawals()
        self._guard, self._guarded = guard, False
        self._speed_scale = speed_scale
        self._motion: GoalExecution | None = None
        self._problem: Problem | None = None
        self._faulty: GoalExecution | None = None  # the goal that ended in the current fault
        self._switching = False
        self._ending = False
        self._lock = threading.RLock()
        self._rested = threading.Condition(self._lock)
        self._authority_changed = threading.Condition(self._lock)
        self._begun = threading.Condition(self._lock)
        self._ticked = threading.Condition(self._lock)
        self.changes: deque[GoalState] = deque()
        self.scene: SceneRevision | None = None

    # -- commands --

    def admit(self, *, preempt: bool = False) -> None:
        """Raise Busy or Unavailable if no motion can start now, or, with `preempt`, as soon as the robot is at rest."""
        with self._lock:
            if self._ending:
                raise Unavailable("the executor is ending; execute again when it has been started again")
            if self._problem is not None and not self._can_leave_fault():
                raise Unavailable(f"the executor is in fault: {self._problem.message}")
            if self._motion is not None and not preempt:
                raise Busy(f"{self._motion.goal.goal_id} has not ended; cancel it or wait, then execute again")
            if self._switching:
                raise Busy("the strategy is being switched; execute again in a moment")
            self._strategy.admit()

    def was_away(self, now: float) -> bool:
        """Whether the control loop stood still until just now, so that a request arriving at `now` may be old."""
        with self._lock:
            return self._clock.suspended(now)

    def start(self, goal: Goal, arrival: int) -> None:
        """Move the robot along the goal's path, which starts at its position.

        Raises what `admit` raises, and Cancelled if a stop, a pause or a cancel of this goal arrived later than this.
        """
        with self._lock:
            self._withdrawals.successor = None
            self._demand_not_overtaken(arrival, goal.goal_id)
            self.admit()
            motion = GoalExecution(goal, self._strategy, self._guard, self.changes)
            motion.start(self._speed_scale)
            self._clock.begin(clock.monotonic() if goal.begun is None else goal.begun)
            self._motion = motion
            self._begun.notify_all()
            if self._problem is not None:
                log.warning("fault cleared goal_id=%s reason=%s", goal.goal_id, self._problem.message)
                self._leave_fault()
            authority = self._guard.of(goal.goal_id)
            if authority is not None:
                limit = self._guard.limit(goal.trajectory, authority.until, authority.obstruction)
                motion.permit(authority, limit, self.scene)

    def _can_leave_fault(self) -> bool:
        """Whether the next goal may leave the present fault."""
        faulty, strategy = self._faulty, self._strategy
        if faulty is None or faulty.outcome is None or faulty.outcome.latched:
            return False
        return faulty.goal.monitor.rests(self._clock.now, strategy.progress(), strategy.joint_state())

    def _leave_fault(self) -> None:
        self._problem = self._faulty = None

    def preempt(self, goal_id: str, arrival: int, patience: float) -> None:
        """Cancel the current goal, if any, so that `goal_id` can start from the robot's rest position.

        Raises Unavailable if the robot is not at rest within `patience` s, and Cancelled as `start` does.
        """
        with self._lock:
            self._demand_not_overtaken(arrival, goal_id)
            self._withdrawals.successor = goal_id
            self._end(None, _cancelled(f"{goal_id} was executed instead, which was to preempt this goal"))
        if not self.wait_for_rest(patience):
            raise Unavailable("the robot does not come to rest; see why (executor/state), then execute again")
        self._demand_not_overtaken(arrival, goal_id)

    def _demand_not_overtaken(self, arrival: float, goal_id: str) -> None:
        """Raise Cancelled if a stop, a pause or a cancel of this goal arrived after the request to start it."""
        if goal_id in self._withdrawals:
            raise Cancelled(f"{goal_id} was cancelled before it started; the robot has not moved")
        if self._order.before_hold(arrival):
            raise Cancelled("a stop or a pause came after this request; this motion has not started")

    def stop(self, why: str, arrival: float) -> None:
        """Cancel any motion. Nothing that arrived earlier is carried out any more."""
        with self._lock:
            self._order.stop(arrival)
            self.cancel(None, why, arrival)

    def cancel(self, goal_id: str | None, why: str, arrival: float) -> None:
        """Cancel this goal, or the current one. A goal that has not come yet, or arrived earlier, will not start."""
        with self._lock:
            if goal_id is not None and self._motion_of(goal_id) is None:
                self._withdrawals.withdraw(goal_id)
            if goal_id in (None, self._withdrawals.successor):
                self._order.end(arrival)
            self._end(goal_id, _cancelled(why))

    def steer(self, goal_id: str, chunk: Chunk, limits: Limits) -> Goal | None:
        """Blend over to this chunk of the stream `goal_id`, and return its goal; None if the stream is not running.

        Raises what `blended` raises.
        """
        with self._lock:
            motion = self._motion_of(goal_id)
            if motion is None:
                return None
            motion.steer(chunk, limits)
            return motion.goal

    def replace(
        self,
        goal_id: str,
        number: int,
        trajectory: TimedTrajectory,
        scene: SceneRevision,
        start: float | Monitor,
        openings: Openings,
        until: float | None = None,
        *,
        joined: Joined | None = None,
    ) -> Goal:
        """Continue the goal along `trajectory`, verified in `scene` with these openings of grippers, instead of its trajectory `number`; returns the
        goal.

        It continues from the path time `start` (s), or, if `start` is a Monitor, from rest and watched by it. It may go
        up to the time `until` (s) of `trajectory`, or to its end if None, until the servo states its authority. `joined` as in `Goal.replaced`. Raises
        ExecutionRefused (`stale_plan`) if the goal follows another trajectory, and what `GoalExecution.replace` and
        `replace_at_rest` raise.
        """
        with self._lock:
            motion = self._motion_of(goal_id)
            followed = None if motion is None else motion.goal.number
            if motion is None or followed != number:
                raise ExecutionRefused(
                    f"trajectory {number} of {goal_id} is not active, {f'{followed} is' if followed else 'it has ended'}; plan from "
                    "the active one (executor/trajectory)",
                    code="stale_plan",
                )
            if isinstance(start, Monitor):
                motion.replace_at_rest(trajectory, start, scene, openings, until)
            else:
                motion.replace(trajectory, start, scene, openings, until, joined=joined)
            return motion.goal

    def receive(self, authority: Authority, now: float) -> None:
        """Take an authority of the servo, received at `now` on the monotonic clock."""
        with self._lock:
            motion = None if authority.goal_id is None else self._motion_of(authority.goal_id)
            trajectory = None if motion is None else motion.goal.trajectory
        limit = None
        if trajectory is not None:  # computed outside the lock, so that no tick waits for it
            limit = self._guard.limit(trajectory, authority.until, authority.obstruction)
        with self._lock:
            newer = self._guard.receive(authority, now)
            if newer and motion is not None and motion is self._motion and motion.goal.trajectory is trajectory:
                motion.permit(authority, limit, self.scene)
            self._authority_changed.notify_all()

    def collide(self, felt: ExternalTorque) -> None:
        """Bring the robot to rest and end the goal in a fault, if the servo felt a collision in it."""
        if felt.joint is None:
            return
        with self._lock:
            motion = None if felt.goal_id is None else self._motion_of(felt.goal_id)
            if motion is not None and motion.outcome is None:
                torque = felt.torque[felt.joint_names.index(felt.joint)]
                motion.fail(
                    ExecutionFailed(
                        f"something pushes {felt.joint} with {abs(torque):.1f} Nm, more than execution.external_torque_limits "
                        "allow; see what the robot has hit",
                        code="collision_detected",
                        joint=felt.joint,
                    )
                )

    def wait_for_authority(self, goal_id: str, scene: SceneRevision | None) -> bool:
        """Wait until a servo has checked this goal in this scene, at most as long as a servo may be silent; returns
        whether one has.
        """
        with self._authority_changed:
            return self._authority_changed.wait_for(
                lambda: self._guard.checked(goal_id, scene, self._clock.now), self._guard.timeout
            )

    def demand_guard(self, goal: Goal) -> None:
        """Raise Unavailable if a servo is required and has given this goal no authority."""
        if self._guard.required and not self.wait_for_authority(goal.goal_id, self.scene):
            raise Unavailable(
                "no servo gives this goal authority, and execution.guard is required: start the servo (`zarm status` shows "
                "it), then execute again"
            )

    def abort(self, goal_id: str, problem: Problem) -> None:
        """Abort the stream `goal_id` for an error of its client; this is not a robot fault."""
        with self._lock:
            self._end(goal_id, Outcome("aborted", problem))

    def _end(self, goal_id: str | None, outcome: Outcome) -> None:
        motion = self._motion_of(goal_id)
        if motion is not None and motion.outcome is None:
            motion.end(outcome)

    def _motion_of(self, goal_id: str | None) -> GoalExecution | None:
        """The motion of this goal, or the current one."""
        motion = self._motion
        return motion if motion is not None and goal_id in (None, motion.goal.goal_id) else None

    def pause(self, arrival: float) -> None:
        """Bring the running goal to rest and hold it."""
        with self._lock:
            self._order.pause(arrival)
            if self._motion is not None:
                self._motion.pause()

    def resume(self, arrival: float, scene: SceneRevision | None = None) -> None:
        """Resume a paused goal in the present scene, `scene`, unless a stop or a pause arrived later.

        Raises what `GoalExecution.resume` raises.
        """
        with self._lock:
            if self._motion is not None and not self._order.before_hold(arrival):
                self._motion.resume(self._speed_scale, scene, self._clock.now)

    def set_speed(self, speed_scale: float) -> None:
        """From now on move at this share of the planned speed; a held goal does so when it resumes."""
        with self._lock:
            self._speed_scale = speed_scale
            if self._motion is not None:
                self._motion.set_speed(speed_scale)

    def reset(self, arrival: float) -> None:
        """Leave `fault`, unless a stop arrived later.

        If a switch left no strategy open, opens it again; if that raises its ZarmError, the fault stays.
        """
        with self._lock:
            if self._order.before_stop(arrival):
                return
            self._active.open()
            self._leave_fault()

    def switch(self, strategy: Strategy, patience: float, arrival: float) -> None:
        """Bring the robot to rest within `patience` s, then let `strategy` move it; a fault stays.

        Raises Busy if a stop arrived later or another switch is in progress, and Unavailable when the process is
        ending, the robot does not come to rest, or `strategy` cannot be opened; the old strategy then stays active. If
        that cannot be opened again either, nothing can move the robot, which is a fault.
        """
        with self._lock:
            if self._ending:
                raise Unavailable("the executor is ending; switch when it has been started again")
            if self._switching:
                raise Busy("the strategy is being switched already; try again in a moment")
            self._demand_no_stop_since(arrival)
            self._switching = True
        try:
            old = self._strategy
            self.cancel(None, f"the strategy was switched from {old.name} to {strategy.name}", arrival)
            with self._lock:
                if not self.wait_for_rest(patience):
                    raise Unavailable(f"the robot does not come to rest; {old.name} is still active")
                self._demand_no_stop_since(arrival)
                try:
                    self._active.switch(strategy)
                except Unavailable as error:
                    if not self._active.is_open:
                        self._problem, self._faulty = error.problem, None
                    raise
        finally:
            self._switching = False

    def _demand_no_stop_since(self, arrival: float) -> None:
        if self._order.before_stop(arrival):
            raise Busy("a stop came after the request to switch; send it again")

    def end(self, patience: float) -> bool:
        """Bring the robot to rest and admit no further motion; returns whether it is at rest within `patience` s."""
        with self._lock:
            self._ending = True
        self.stop("the executor was told to end", math.inf)
        return self.wait_for_rest(patience)

    def release(self) -> None:
        """Close the active strategy; no command and no tick may follow."""
        with self._lock:
            self._active.close()

    # -- state --

    @property
    def _strategy(self) -> Strategy:
        return self._active.strategy

    def state(self) -> ExecutorState:
        """The robot's current state."""
        with self._lock:
            return ExecutorState(
                mode=self._mode(),
                strategy=self._strategy.name,
                goal_id=self._motion.goal.goal_id if self._motion else None,
                problem=self._problem,
                scene_changed=not self._guarded and self._motion is not None and self._motion.goal.scene != self.scene,
                guarded=self._guarded,
                speed_scale=self._speed_scale,
                missed_ticks=self._clock.missed,
            )

    def news(self) -> tuple[tuple[GoalState, ...], ExecutorState]:
        """Take the goal states out of `changes`; returns them and the robot's resulting state."""
        with self._lock:
            changes = tuple(self.changes)
            self.changes.clear()
            return changes, self.state()

    def unchecked_plan(self) -> str | None:
        """The active goal, if it follows what was verified before the motion, and no servo checks it now."""
        with self._lock:
            motion = self._motion
            return motion.goal.goal_id if motion and motion.goal.verified and not self._guarded else None

    def goal_state(self) -> GoalState | None:
        """The state of the current goal, if any."""
        with self._lock:
            return self._motion.state() if self._motion else None

    def sequence(self, goal_id: str) -> int | None:
        """The number of the newest chunk of the stream `goal_id`; None if the stream is not running."""
        with self._lock:
            motion = self._motion_of(goal_id)
            return motion.goal.chunk.sequence if motion is not None and motion.goal.chunk is not None else None

    def moves(self) -> bool:
        """Whether there is a goal that has not ended."""
        return self._motion is not None

    def joint_state(self) -> Measured | None:
        """The newest measured state of the robot."""
        with self._lock:
            return self._strategy.joint_state()

    def wait_for_joint_state(self, since: float, patience: float) -> Measured | None:
        """The newest measured state, as soon as it dates from `since` (s, monotonic clock) or later, or after
        `patience` s.

        A robot at rest reports its position as rarely as its executor allows, and a busy machine passes it on late.
        """

        def fresh() -> bool:
            measured = self._strategy.joint_state()
            return measured is not None and measured.time >= since

        with self._ticked:
            self._ticked.wait_for(fresh, clock.real_seconds(patience))
            return self._strategy.joint_state()

    def wait_for_rest(self, patience: float) -> bool:
        """Wait until no goal is left; returns whether that happened within `patience` s."""
        with self._rested:
            return self._rested.wait_for(lambda: self._motion is None, clock.real_seconds(patience))

    def wait_for_news(self, patience: float) -> None:
        """Wait until there is a goal or `changes` to publish, for at most `patience` s."""
        with self._begun:
            self._begun.wait_for(lambda: self._motion is not None or self.changes, clock.real_seconds(patience))

    def _mode(self) -> RobotMode:
        if self._motion is not None:
            return self._motion.mode
        return "idle" if self._problem is None else "fault"

    # -- the control loop --

    def tick(self, now: float) -> Measured | None:
        """One control period at `now` (s, monotonic clock); returns the measured state of the robot."""
        with self._lock:
            dt = self._clock.advance(now)
            motion = self._motion
            if motion is not None and dt > STALL_LIMIT and not self._strategy.progress().at_rest:
                motion.fail(_stalled(dt))
            self._strategy.tick(now, dt)
            self._guarded = self._guard.confirm(None if motion is None else motion.goal.goal_id, self.scene, now)
            if motion is not None:
                ended = motion.advance(now, dt, guarded=self._guarded)
                if ended is not None:
                    self._rest(motion, ended)
            self._ticked.notify_all()
            return self._strategy.joint_state()

    def _rest(self, motion: GoalExecution, ended: Outcome) -> None:
        self._motion = None
        self._strategy.end()
        if ended.fault:
            self._problem, self._faulty = ended.problem, motion
        self._rested.notify_all()


def _cancelled(why: str) -> Outcome:
    return Outcome("cancelled", Problem(code="cancelled", message=why))


def _stalled(dt: float) -> ExecutionFailed:
    return ExecutionFailed(
        f"the executor's control loop stood still for {dt:.2f} s while the robot moved (at most {STALL_LIMIT:g} s); find "
        "out what slows this machine down",
        code="driver_stalled",
    )
