"""Admission of goals: they are checked one at a time, and one that has been stopped meanwhile does not start."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from zarm_contract.errors import Busy, ZarmError
from zarm_executor.goal import Goal
from zarm_executor.machine import Machine
from zarm_executor.reporter import Reporter
from zarm_executor.strategies.base import Measured
from zarm_runtime import clock

REST_PATIENCE = 10.0
"""Longest wait (s) for a moving robot to come to rest; it needs roughly its velocity limit divided by its acceleration
limit.
"""


@dataclass(frozen=True)
class Turn:
    """What may be done while the goal requested at `arrival` is the one being checked."""

    machine: Machine
    reporter: Reporter
    arrival: int

    def preempt(self, goal_id: str) -> None:
        """End the current goal in favour of `goal_id`, and wait for rest. Raises what `Machine.preempt` raises."""
        try:
            self.machine.preempt(goal_id, self.arrival, REST_PATIENCE)
        finally:
            self.reporter.publish()

    def start(self, goal: Goal) -> None:
        """Start a goal, once the servo has seen its trajectory if that is required.

        Raises what `Machine.demand_guard` and `Machine.start` raise, and Unavailable if the goal cannot be recorded.
        """
        self.reporter.remember(goal.before_motion())
        try:
            self.reporter.show(goal)
            self.machine.demand_guard(goal)
            self.machine.start(goal, self.arrival)
        except ZarmError:
            self.reporter.forget()
            raise
        self.reporter.publish()


class Admission:
    """The only way to start a goal. Thread-safe. Joints are fresh for `joint_state_timeout` (s)."""

    def __init__(self, machine: Machine, reporter: Reporter, joint_state_timeout: float) -> None:
        self._machine = machine
        self._reporter = reporter
        self._joint_state_timeout = joint_state_timeout
        self._checking = threading.Lock()

    def demand_presence(self) -> None:
        """Raises Busy if a request arriving now may be old, and given up by its client since."""
        if self._machine.was_away(clock.monotonic()):
            raise Busy("the executor stood still for so long that the client may have given up; try again in a moment")

    def joint_state(self) -> Measured | None:
        """The measured state of the robot: a fresh one, or the last one if no fresh one arrives within
        `joint_state_timeout`.
        """
        timeout = self._joint_state_timeout
        return self._machine.wait_for_joint_state(clock.monotonic() - timeout, timeout)

    @contextmanager
    def turn(self, arrival: int, *, preempt: bool = False) -> Iterator[Turn]:
        """A context in which the goal requested at `arrival` is checked and started. One at a time.

        Raises Busy, and what `Machine.admit` raises.
        """
        if not self._checking.acquire(blocking=False):
            raise Busy("another motion is being checked; execute again when it has ended or been refused")
        try:
            self.demand_presence()
            self._machine.admit(preempt=preempt)
            yield Turn(self._machine, self._reporter, arrival)
        finally:
            self._checking.release()
