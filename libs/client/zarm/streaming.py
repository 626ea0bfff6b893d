"""Closed-loop control: a stream of short trajectories, each replacing the rest of the one before."""

from __future__ import annotations

import secrets
import time

from pydantic import ValidationError

from zarm.connection import ANSWER_SECONDS, Connection
from zarm.values import invalid
from zarm_contract.errors import Unavailable, from_problem
from zarm_contract.messages import GoalState, StreamChunk, Trajectory
from zarm_runtime import clock

_LOOK_SECONDS = 0.005


class Stream:
    """One stream, which is one goal of the executor, `goal_id`; `Robot.stream` makes it. Raises Unavailable without an
    executor."""

    def __init__(self, connection: Connection, deadline: float) -> None:
        self.goal_id = f"stream-{secrets.token_hex(8)}"
        self._connection = connection
        self._deadline = deadline
        self._newest: StreamChunk | None = None
        self._began = 0.0
        self._publisher = connection.publisher(connection.keys.stream)
        connection.interrupts.run_interruptibly(connection.goals.listen)
        connection.interrupts.run_interruptibly(self._wait_for_subscriber)

    @property
    def time(self) -> float:
        """s since the first trajectory was sent; 0 before."""
        return clock.monotonic() - self._began if self._newest is not None else 0.0

    @property
    def state(self) -> GoalState | None:
        """The newest state of its goal; None before the first one."""
        return self._connection.goals.known(self.goal_id)

    @property
    def running(self) -> bool:
        """Whether the stream has not ended yet."""
        return (state := self.state) is None or not state.done

    def send(self, trajectory: Trajectory, *, start: float | None = None, last: bool = False) -> None:
        """Send what the robot is to do from `start` on (s in stream time; default: now).

        The first trajectory begins at 0 s, where the robot rests. Each trajectory ends at rest, so that the robot can
        always stop along it. The executor blends from the present motion into it, which needs some reserve to the
        limits. The stream succeeds at the end of the `last` one. Raises the problem with which the stream has ended.
        """
        if (state := self.state) is not None and state.problem is not None:
            raise from_problem(state.problem)
        before = self._newest
        try:
            chunk = StreamChunk(
                goal_id=self.goal_id,
                sequence=1 if before is None else before.sequence + 1,
                start=self.time if start is None else start,
                trajectory=trajectory,
                deadline=self._deadline,
                last=last,
            )
        except ValidationError as error:
            raise invalid("the chunk", error) from None
        if before is None:
            self._began = clock.monotonic()
        self._newest = chunk
        self._publisher.put(chunk)

    @property
    def open(self) -> bool:
        """Whether it is running, and expects more."""
        return self._newest is not None and not self._newest.last and self.running

    def end(self) -> GoalState | None:
        """Wait for its end; returns its last state, None if nothing was sent. Raises Unavailable if nothing is heard of
        it.
        """
        if self._newest is not None:
            for _ in self._connection.goals.states(self.goal_id, self._connection.interrupts):
                pass
        return self.state

    def _wait_for_subscriber(self) -> None:
        deadline = time.monotonic() + ANSWER_SECONDS
        while not self._publisher.has_subscribers():
            if time.monotonic() > deadline:
                raise Unavailable(
                    f"no executor accepts streams for {self._connection.keys.robot}; `zarm status` shows whether its executor runs"
                )
            time.sleep(_LOOK_SECONDS)
