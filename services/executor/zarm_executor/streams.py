"""Closed-loop streams: each chunk from a client replaces the rest of the one before."""

from __future__ import annotations

import logging
from collections import OrderedDict

import numpy as np

from zarm_contract.errors import InvalidRequest, ZarmError
from zarm_contract.messages import GoalState, StreamChunk
from zarm_contract.robot import RobotDescription
from zarm_executor.admission import Admission
from zarm_executor.checks import continuation, executable, placed
from zarm_executor.goal import Chunk, Goal
from zarm_executor.machine import Machine
from zarm_executor.monitor import Monitor
from zarm_executor.reporter import Reporter
from zarm_executor.tick_clock import EARLIEST
from zarm_runtime import clock
from zarm_trajectory.arrays import Array
from zarm_trajectory.blending import blended
from zarm_trajectory.limits import Limits
from zarm_trajectory.trajectory import TimedTrajectory

log = logging.getLogger(__name__)

STREAMS_KEPT = 256
"""Number of begun or refused streams remembered, so that none begins a second time."""


class Streams:
    """Reads `executor/stream`. Chunks are not answered: the state of the goal reports what becomes of them."""

    def __init__(self, robot: RobotDescription, machine: Machine, reporter: Reporter, admission: Admission) -> None:
        self._robot = robot
        self._limits = Limits.of(robot)
        self._machine = machine
        self._reporter = reporter
        self._admission = admission
        self._turns: Array = np.zeros(len(robot.descriptor.joints))
        self._known: OrderedDict[str, bool] = OrderedDict()

    def receive(self, _key: str, chunk: StreamChunk, arrival: int) -> None:
        """Begin the stream, or blend over to this chunk; one call at a time."""
        received = clock.monotonic()
        sequence = self._machine.sequence(chunk.goal_id)
        if sequence is not None:
            if chunk.sequence > sequence:
                self._go_on(chunk, received)
            else:
                self._drop(chunk, f"its number is not above {sequence}")
        elif chunk.goal_id in self._known or chunk.goal_id == self._machine.state().goal_id:
            self._drop(chunk, "that goal has ended or takes no chunks")
        elif chunk.sequence == 1:
            self._begin(chunk, received, arrival)
        else:
            self._drop(chunk, "its stream is unknown and begins with number 1")

    def _begin(self, chunk: StreamChunk, received: float, arrival: int) -> None:
        self._know(chunk.goal_id)
        try:
            with self._admission.turn(arrival) as turn:
                if chunk.start != 0.0:
                    raise InvalidRequest("the first chunk of a stream must start at 0", field="start")
                planned = executable(chunk.trajectory, self._robot)
                trajectory, at = placed(planned, self._admission.joint_state(), clock.monotonic(), self._robot)
                self._turns = trajectory.start - planned.start
                # The robot may be off by the start tolerance: blend from its position as between two chunks.
                trajectory = blended(TimedTrajectory.standing(at.position), 0.0, trajectory, 0.0, self._limits)
                monitor = Monitor(trajectory, self._robot.descriptor)
                piece = self._chunk(chunk, trajectory, received)
                begun = _begun(chunk)
                turn.start(Goal(chunk.goal_id, None, trajectory, monitor, piece.scene, chunk=piece, begun=begun))
        except ZarmError as error:
            self._refuse(chunk, error)

    def _go_on(self, chunk: StreamChunk, received: float) -> None:
        try:
            trajectory = continuation(chunk.trajectory, self._robot, self._turns)
            goal = self._machine.steer(chunk.goal_id, self._chunk(chunk, trajectory, received), self._limits)
            if goal is not None:
                self._reporter.show(goal)
        except ZarmError as error:
            self._machine.abort(chunk.goal_id, error.problem)
            self._reporter.publish()

    def _chunk(self, chunk: StreamChunk, trajectory: TimedTrajectory, received: float) -> Chunk:
        return Chunk(
            chunk.sequence, chunk.start, trajectory, received, chunk.deadline, chunk.last, scene=self._machine.scene
        )

    def _refuse(self, chunk: StreamChunk, error: ZarmError) -> None:
        """Report under the stream's goal why it has not begun."""
        position = chunk.trajectory.position[0]
        state = GoalState(
            goal_id=chunk.goal_id,
            status="cancelled" if error.code == "cancelled" else "aborted",
            progress=0.0,
            elapsed=0.0,
            duration=chunk.trajectory.time[-1],
            joint_command=position,
            problem=error.problem,
        )
        self._reporter.report(state)

    def _drop(self, chunk: StreamChunk, why: str) -> None:
        if not self._known.get(chunk.goal_id, False):
            log.warning("dropped a chunk goal_id=%s sequence=%d reason=%s", chunk.goal_id, chunk.sequence, why)
        self._know(chunk.goal_id, logged=True)

    def _know(self, goal_id: str, *, logged: bool = False) -> None:
        """Remember a stream, and whether the log already says (`logged`) that a chunk of it was dropped."""
        self._known[goal_id] = logged
        if len(self._known) > STREAMS_KEPT:
            self._known.popitem(last=False)


def _begun(chunk: StreamChunk) -> float | None:
    """Since when (s, monotonic) the time of a stream counts; None if it says nothing, or another clock is far off."""
    if chunk.begin_at is None:
        return None
    since = clock.unix_time() - chunk.begin_at
    if 0.0 <= since <= EARLIEST:
        return clock.monotonic() - since
    log.warning("a stream begins when it arrives, its clock is off goal_id=%s since=%.3f", chunk.goal_id, since)
    return None
