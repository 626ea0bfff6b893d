"""The executor of a robot: goals, streams, commands that stop or slow them, and the state of the robot."""

from __future__ import annotations

import secrets
from collections.abc import Callable, Generator, Iterator
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING

from zarm.calls import Calls
from zarm.connection import ANSWER_SECONDS
from zarm.values import made
from zarm_contract.errors import ExecutionRefused, Unavailable, from_problem
from zarm_contract.messages import (
    CancelRequest,
    Continuation,
    ExecuteRequest,
    ExecutorState,
    GoalState,
    JointState,
    Nothing,
    Plan,
    SpeedRequest,
    Strategies,
    StrategyRequest,
    Trajectory,
)

if TYPE_CHECKING:
    from zarm.streaming import Stream

REST_SECONDS = 30.0
"""Longest wait (s) for the robot to come to rest, including what must end first."""

_MEASURED_SECONDS = 2.0

OnProgress = Callable[[GoalState], object]
"""Called with each state of a goal that differs from the previous one."""


class Executor(Calls):
    """Goals and streams, commands that stop, pause or slow whatever moves the robot, and its state."""

    def execute(
        self,
        what: Plan | Trajectory | ExecuteRequest | str | None = None,
        *,
        preempt: bool = False,
        replan: bool = False,
        on_progress: OnProgress | None = None,
    ) -> GoalState:
        """Move the robot along a plan and wait until it rests at the end. Returns the goal's last state.

        `what` is a plan, the id of a plan, or a trajectory, which is not checked against the scene; by default the last
        plan. While another goal is active this raises Busy, unless `preempt` cancels that goal first. With `replan` the
        servo replans during motion when an obstacle appears. `on_progress` receives the goal's state about ten times a
        second; an exception in it stops the robot.

        Ctrl-C cancels the goal, waits until the robot rests, and then raises KeyboardInterrupt; a second Ctrl-C does
        not wait. Raises ExecutionRefused before and ExecutionFailed during the motion, Cancelled if another client
        ended it, and Unavailable if the executor is gone and the state of the robot is unknown.
        """
        with self._new_goal() as goal_id:
            self._send(what, goal_id, preempt, replan)
            last = self._followed(goal_id, on_progress)
        if last.problem is not None:
            raise from_problem(last.problem)
        return last

    def take_over(self, plan: Plan, where: Continuation, on_progress: OnProgress | None = None) -> GoalState:
        """Let a plan take over from a running goal, `where` it was planned to, and wait for the end of that goal. Returns its last state.

        From then on it is a goal of this client: Ctrl-C, or an exception in `on_progress`, stops the robot, as in `execute`.
        """
        with self._new_goal(where.goal_id) as goal_id:
            self._ask(self._keys.execute, ExecuteRequest(plan_id=plan.plan_id, continues=where))
            last = self._followed(goal_id, on_progress)
        if last.problem is not None:
            raise from_problem(last.problem)
        return last

    def start(
        self,
        what: Plan | Trajectory | ExecuteRequest | str | None = None,
        *,
        preempt: bool = False,
        replan: bool = False,
        goal_id: str | None = None,
        timeout: float = REST_SECONDS,
    ) -> str:
        """`execute` without waiting. Returns the id of the goal, for `follow` and `cancel`; the motion continues
        without this program.

        `goal_id` names the goal (default: a new id). If the executor does not accept or refuse it within `timeout` s,
        it is withdrawn.
        """
        with self._new_goal(goal_id) as named:
            self._send(what, named, preempt, replan, timeout)
        return named

    def follow(
        self,
        goal_id: str,
        on_progress: OnProgress | None = None,
        *,
        timeout: float | None = None,
    ) -> GoalState:
        """Wait for the end of a goal, whoever started it. Returns its last state, which says whether it succeeded.

        Ctrl-C ends the wait, not the goal. Raises Unavailable if nothing is heard of the goal for 10 s, or if it has
        not ended after `timeout` s.
        """
        for state in self.goal_states(goal_id, timeout=timeout):
            if on_progress is not None:
                on_progress(state)
        return state

    def goal_states(self, goal_id: str, *, timeout: float | None = None) -> Generator[GoalState]:
        """The states of a goal up to its last one, each different from the one before. Raises as `follow` does."""
        before: GoalState | None = None
        for state in self.connection.goals.states(goal_id, self.connection.interrupts, timeout=timeout):
            if state != before:
                before = state
                yield state

    def cancel(self, goal_id: str | None = None, *, timeout: float = ANSWER_SECONDS) -> ExecutorState:
        """Cancel a goal, by default the active one; the robot brakes to rest. Cancelling a finished goal is no error."""
        request = made(CancelRequest, goal_id=goal_id)
        return self._ask(self._keys.cancel, request, timeout=timeout)

    def stop(self) -> ExecutorState:
        """Stop the robot now, whoever moves it; it brakes to rest."""
        return self._ask(self._keys.stop, Nothing())

    def pause(self) -> ExecutorState:
        """Pause the motion; `resume` continues it."""
        return self._ask(self._keys.pause, Nothing())

    def resume(self) -> ExecutorState:
        """Continue a paused motion."""
        return self._ask(self._keys.resume, Nothing())

    def reset(self) -> ExecutorState:
        """Leave the fault state, once its cause is fixed."""
        return self._ask(self._keys.reset, Nothing())

    def speed(self, scale: float | None = None) -> float:
        """The share (0.05 to 1) of the planned speed at which the robot moves. With `scale`, sets it first."""
        if scale is None:
            return self.connection.read(self._keys.speed).speed_scale
        return self._ask(self._keys.speed, made(SpeedRequest, speed_scale=scale)).speed_scale

    def strategy(self, name: str | None = None) -> Strategies:
        """The control strategies of this robot and the active one. With `name`, switches first."""
        if name is None:
            return self.connection.read(self._keys.strategy)
        return self._ask(self._keys.strategy, made(StrategyRequest, strategy=name), timeout=REST_SECONDS)

    @contextmanager
    def stream(self, *, deadline: float = 0.2) -> Iterator[Stream]:
        """A stream of short trajectories for closed-loop control, each replacing the rest of the one before.

        ```python
        with robot.stream() as stream:
            while stream.running and not done:
                stream.send(trajectory_from(stream.time))
        ```

        The next one must be sent within `deadline` s (at most 1); otherwise the robot brakes and DeadlineExceeded is raised.
        Leaving the block waits until the robot rests: at the end of a trajectory sent as the `last`, or by braking at once.
        """
        from zarm.streaming import Stream

        stream = Stream(self.connection, deadline)
        try:
            yield stream
        except BaseException:
            self._rest(stream.goal_id)
            raise
        if stream.open:
            self._rest(stream.goal_id)
        elif (end := stream.end()) is not None and end.problem is not None:
            raise from_problem(end.problem)

    def state(self) -> ExecutorState:
        """The present state of the executor."""
        return self.connection.read(self._keys.executor_state)

    def states(self) -> Generator[ExecutorState]:
        """The present state of the executor, then every change; endless."""
        return self.connection.latched(self._keys.executor_state)

    def joint_state(self) -> JointState:
        """The next measured joint state (rad, rad/s). Raises ExecutionRefused (`no_joint_state`) if none arrives."""
        state = self.connection.next(self._keys.joint_states, _MEASURED_SECONDS)
        if state is None:
            raise ExecutionRefused(
                f"no joint state of {self.name} came within {_MEASURED_SECONDS:g} s; `zarm status` shows whether its executor "
                "runs and with which strategy",
                code="no_joint_state",
            )
        return state

    def joint_states(self) -> Generator[JointState]:
        """Measured joint states (rad, rad/s), endless; a loop that is slower gets the newest."""
        return self.connection.published(self._keys.joint_states)

    @contextmanager
    def _new_goal(self, goal_id: str | None = None) -> Iterator[str]:
        """The id of a new goal; an interruption in the block brings the robot to rest, and reports its state."""
        goal_id = goal_id or f"goal-{secrets.token_hex(8)}"
        try:
            yield goal_id
        except KeyboardInterrupt as interruption:
            if interruption.args:  # from a rest that the user would not wait for
                raise
            raise KeyboardInterrupt(self._rest(goal_id)) from None

    def _send(
        self,
        what: Plan | Trajectory | ExecuteRequest | str | None,
        goal_id: str,
        preempt: bool,
        replan: bool,
        timeout: float = REST_SECONDS,
    ) -> None:
        """Request a goal; one that gets no answer is withdrawn."""
        request = _execution(what)
        flags = {"preempt": preempt or request.preempt, "replan": replan or request.replan}
        request = request.model_copy(update={"goal_id": goal_id, **flags})
        self.connection.interrupts.run_interruptibly(self.connection.goals.listen)
        try:
            with self.connection.interrupts.insist(f"the executor of {self.name} to take the goal or refuse it"):
                self._ask(self._keys.execute, request, timeout=timeout)
        except Unavailable:  # the executor may have received the request, and start it yet
            with self._until_left(), suppress(Unavailable):
                self.cancel(goal_id)
            raise

    def _followed(self, goal_id: str, on_progress: OnProgress | None) -> GoalState:
        for state in self.goal_states(goal_id):
            if on_progress is not None:
                try:
                    on_progress(state)
                except Exception:
                    self._rest(goal_id)
                    raise
        return state

    def _rest(self, goal_id: str) -> str:
        """Cancel a goal of this client and wait until the robot rests; returns its state in words."""
        with self._until_left():
            cancelled: ExecutorState | None = None
            with suppress(Unavailable):
                cancelled = self.cancel(goal_id)
            known = self.connection.goals.known(goal_id)
            if cancelled is None and known is None:
                return self._unknown()
            if cancelled is not None and cancelled.goal_id != goal_id and known is None:
                return "cancelled: the goal is withdrawn, and the robot has not moved for it"
            last = self.follow(goal_id, timeout=REST_SECONDS)
            return f"{last.status}: the robot stands still at {last.progress:.0%} of the motion"


def _execution(what: Plan | Trajectory | ExecuteRequest | str | None) -> ExecuteRequest:
    match what:
        case ExecuteRequest():
            return what
        case Plan():
            return ExecuteRequest(plan_id=what.plan_id)
        case Trajectory():
            return ExecuteRequest(trajectory=what)
        case _:
            return made(ExecuteRequest, plan_id=what)
