"""Opens and ends sessions on request, one at a time."""

from __future__ import annotations

import logging
import secrets
import threading
from collections import deque

import numpy as np

from zarm_contract.codec import decode
from zarm_contract.errors import Busy, ExecutionRefused, InvalidRequest, Unavailable
from zarm_contract.messages import (
    Accepted,
    ChunkAccepted,
    ExecutorState,
    GoalState,
    GoalTrajectory,
    Nothing,
    ServoChunk,
    ServoEnd,
    ServoStart,
    ServoTarget,
)
from zarm_runtime import clock
from zarm_servo.tracking.session import Session, SessionConfig
from zarm_trajectory.arrays import Array

log = logging.getLogger(__name__)

_FRESH = 0.5
"""Joints measured longer ago than this (s) cannot start a session."""
_NEWS = 0.5
"""How long (s) to wait for news that a client may already have from the executor: that a goal has ended."""


class Sessions:
    """The sessions of one robot, one at a time."""

    def __init__(self, config: SessionConfig) -> None:
        self._config = config
        self._executor: ExecutorState | None = None
        self._session: Session | None = None
        self._ended: deque[str] = deque(maxlen=32)
        self._lock = threading.Lock()
        self._news = threading.Condition()  # from the executor
        config.world.on_state.append(self._on_state)
        config.world.on_goal.append(self._on_goal)
        config.world.on_trajectory.append(self._on_trajectory)

    def newest(self) -> Session | None:
        """The session that was opened last, whether it has ended or not."""
        return self._session

    def start(self, request: ServoStart) -> Accepted:
        """Open a session.

        Raises Busy, ExecutionRefused (`no_joint_state`), Unavailable without an executor or a scene, and the executor's
        refusal of the stream.
        """
        with self._lock:
            before = self._open()
            if before is not None:
                if not request.take_over:
                    raise Busy(
                        f"the session {before.goal_id} is open; end it (servo/end), or take over (take_over), which brings the "
                        "robot to rest first"
                    )
                log.info("session taken over goal_id=%s", before.goal_id)
                before.close()
            executor = self._free_executor()
            if self._config.world.scene.snapshot(clock.monotonic()).revision is None:
                raise Unavailable(
                    "the scene is unknown, so collisions could not be avoided; start the planner, then start the session again"
                )
            goal_id = request.goal_id or f"servo-{secrets.token_hex(8)}"
            session = Session(goal_id, request, self._config, self._position(), self._delay(executor))
            session.on_speed(executor)
            self._session = session
            session.open()
            log.info("session open goal_id=%s margin=%g", goal_id, request.margin)
            return Accepted(goal_id=goal_id)

    def end(self, request: ServoEnd) -> Nothing:
        """End a session; does nothing if there is none of that name. Raises Busy if the robot does not come to rest."""
        session = self._open()
        if session is not None and request.goal_id in (None, session.goal_id):
            session.close()
        return Nothing()

    def on_target(self, _key: str, payload: bytes) -> None:
        """Take a live target; those of other sessions are ignored."""
        now, session = clock.monotonic(), self._open()
        if session is None:
            return
        try:
            message = decode(ServoTarget, payload)
        except InvalidRequest as error:
            session.inbox.refuse(error.problem, now)
            return
        if message.goal_id == session.goal_id:
            session.inbox.receive(message, now)

    def take(self, chunk: ServoChunk) -> ChunkAccepted:
        """Take a chunk of the open session. Raises Unavailable if that is another one, and InvalidRequest as `Session.take`."""
        session = self._open()
        if session is None or session.goal_id != chunk.goal_id:
            raise Unavailable(
                f"the session {chunk.goal_id} is not open; start one (servo/start), and send it chunks while it runs"
            )
        return session.take(chunk)

    def _on_trajectory(self, message: GoalTrajectory) -> None:
        session = self._session
        if session is not None and session.goal_id == message.goal_id:
            session.on_trajectory(message)

    def _on_goal(self, goal: GoalState) -> None:
        """Take a goal state from the executor; the executor state that follows it may still be on its way."""
        if goal.done:
            with self._news:
                self._ended.append(goal.goal_id)
                self._news.notify_all()
        session = self._session
        if session is not None and session.goal_id == goal.goal_id:
            session.on_goal(goal)

    def _on_state(self, state: ExecutorState) -> None:
        """Take the executor's state."""
        with self._news:
            self._executor = state
            self._news.notify_all()
        session = self._open()
        if session is not None:
            session.on_speed(state)

    def _free_executor(self) -> ExecutorState:
        """The idle executor. Raises Unavailable if none is heard, and Busy if it runs a goal."""
        with self._news:
            self._news.wait_for(lambda: self._executor is not None and self._goal() is None, _NEWS)
            executor, goal = self._executor, self._goal()
        if executor is None:
            raise Unavailable("no executor answers; start it (`zarm status` shows it), then start the session again")
        if goal is not None:
            raise Busy(f"{goal} has not ended; cancel it or wait, then start the session again")
        return executor

    def _goal(self) -> str | None:
        """The goal that the executor is running."""
        goal = None if self._executor is None else self._executor.goal_id
        return None if goal in self._ended else goal

    def close(self) -> None:
        """End the open session, if any."""
        self.end(ServoEnd())

    def _open(self) -> Session | None:
        session = self._session
        return None if session is None or session.ended else session

    def _position(self) -> Array:
        """The robot's measured position (J,)."""
        joints, measured = self._config.robot.descriptor.joints, self._config.world.measured.get(max_age=_FRESH)
        if measured is None or set(measured.joint_names) != set(joints):
            raise ExecutionRefused(
                f"the robot has not reported its joints for {_FRESH:g} s; check that its driver runs",
                code="no_joint_state",
            )
        return np.array([measured.position[measured.joint_names.index(joint)] for joint in joints])

    def _delay(self, executor: ExecutorState) -> float:
        """How far (s) the executor expects the robot to be behind the command."""
        timing = self._config.robot.descriptor.command_timing
        return 0.0 if timing is None or executor.strategy == "emulator" else timing.delay
