"""Whose turn it is to move the robot, among the goals of ROS clients."""

from __future__ import annotations

import threading
from collections.abc import Callable

from zarm_contract.errors import Busy
from zarm_ros_bridge.engine import Engine
from zarm_ros_bridge.goals import ASK_SECONDS, Run, states_of

REST_SECONDS = 15.0
"""Longest wait (s) for the robot to come to rest when its goal is preempted."""


class Turns:
    """One goal has the turn at a time. `preempts` says whether a newer one takes its place. Thread-safe."""

    def __init__(self, engine: Engine, preempts: Callable[[], bool]) -> None:
        self._engine = engine
        self._preempts = preempts
        self._turn = threading.Condition()
        self._running: Run | None = None
        self._newest: Run | None = None  # the one that came last

    @property
    def running(self) -> Run | None:
        """The goal that has the turn."""
        return self._running

    def free(self) -> bool:
        """Whether a goal that comes now may have the turn."""
        return self._running is None or self._preempts()

    def take(self, run: Run, *, preempt: bool | None = None) -> None:
        """Wait for the running goal to end if this one preempts it (default: as `preempts` says); the newest goal has the turn.

        Raises Busy if it does not preempt, or if the robot does not come to rest, and Cancelled if a later goal came.
        """
        preempt = self._preempts() if preempt is None else preempt
        with self._turn:
            other = self._running
            if other is not None and not preempt:
                raise Busy(busy())
            if preempt and self._newest is not None and self._newest.handle.arrival > run.handle.arrival:
                raise run.overtaken()
            self._newest = run
            if other is None:
                self._running = run
            self._turn.notify_all()
        if other is not None:
            other.preempt()
            self._wait_for(run)
        client = self._engine.client
        if preempt and (goal_id := client.state().goal_id) not in (None, run.name):  # of a client elsewhere
            client.cancel(goal_id, timeout=ASK_SECONDS)
            for _ in states_of(self._engine, goal_id):
                run.go_on()

    def pass_on(self, run: Run) -> None:
        """This goal has ended; it needs not have had the turn."""
        with self._turn:
            if self._running is run:
                self._running = None
                self._turn.notify_all()

    def _wait_for(self, run: Run) -> None:
        with self._turn:
            free = self._turn.wait_for(lambda: self._newest is not run or self._running is None, REST_SECONDS)
            if self._newest is not run:
                raise run.overtaken()
            if not free:
                raise Busy(busy())
            self._running = run


def busy() -> str:
    """Why a goal cannot have the turn."""
    return "another goal of this robot runs; cancel it first, or set the parameter preempt"
