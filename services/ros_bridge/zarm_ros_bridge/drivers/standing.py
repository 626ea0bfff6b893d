"""Which of a driver's joint states are passed on: all while the robot moves, some while it is at rest."""

from __future__ import annotations

from zarm_contract.messages import JointState

_OF_TIMEOUT = 0.6
"""Interval of those passed on at rest, as a share of the descriptor's `joint_state_timeout`: 17 Hz for 0.1 s. More
would be of no use to anyone, and each costs the executor some 0.3 ms of CPU.
"""
_MAX_INTERVAL = 0.1
"""Longest interval (s), however long the executor waits: a planner rejects joints older than half a second."""
_TOLERANCE = 1.1
"""Factor by which the interval may grow if the driver is slightly irregular."""
_PAUSE = 0.03
"""How long (s) the next ones may wait at rest: waking up for each took half of what they cost."""
_MOVED = 1e-4
_MOVING = 1e-3
"""A robot moves if it is this far (rad) from its last reported position, or this fast (rad/s)."""


class Standing:
    """Decides which joint states are passed on to an executor that waits for them for `timeout` (s)."""

    def __init__(self, timeout: float) -> None:
        self._period = min(_OF_TIMEOUT * timeout, _MAX_INTERVAL)
        self._passed: JointState | None = None
        self._passed_at = self._came_at = 0.0
        self.pause: float | None = None
        """How long (s) the next joint states may wait; None while the robot moves."""

    def passes(self, state: JointState, now: float) -> bool:
        """Whether this one is passed on, received at `now` (s) of a monotonic clock."""
        before, since = self._passed, now - self._came_at
        self._came_at = now
        moves = before is None or _moves(before, state)
        self.pause = None if moves else min(_PAUSE, self._period / 2)
        if not moves and now + since - self._passed_at <= _TOLERANCE * self._period:  # the next one is soon enough
            return False
        self._passed, self._passed_at = state, now
        return True


def _moves(before: JointState, state: JointState) -> bool:
    if state.joint_names != before.joint_names or max(map(abs, state.velocity), default=0.0) > _MOVING:
        return True
    return any(abs(now - then) > _MOVED for now, then in zip(state.position, before.position, strict=True))
