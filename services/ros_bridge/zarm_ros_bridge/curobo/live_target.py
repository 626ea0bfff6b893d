"""The pose that a goal in closed loop follows."""

from __future__ import annotations

import threading

from zarm.servoing import PERIOD, Tracking
from zarm_contract.messages import Pose, ServoSession

_PAUSE = 0.08
"""A stream of poses without a new one for this long (s) has paused: the robot brakes for a target older than 0.1 s."""
_ZERO_VELOCITY = (0.0, 0.0, 0.0)


class LiveTarget:
    """The tip's target `pose` in the base frame, until `put` moves it. Thread-safe.

    With `timed`, poses at least every 0.08 s are a stream: their differences determine a velocity. Otherwise the tip is
    to rest at each.
    """

    def __init__(self, pose: Pose, *, timed: bool) -> None:
        self.pose = pose
        self._timed = timed
        self._changed = threading.Condition()
        self._new = True
        self._streaming = False
        self._sent = 0
        self._first = 1  # the sequence number of the first target at this pose

    def put(self, pose: Pose) -> None:
        """Move it."""
        with self._changed:
            self.pose, self._new = pose, True
            self._changed.notify_all()

    def lead(self, tracking: Tracking) -> bool:
        """Send the target to the servo when it moves or must be repeated; returns whether it has moved to a place of
        rest.

        Raises the session's error.
        """
        with self._changed:
            self._changed.wait_for(lambda: self._new, _PAUSE if self._streaming else PERIOD)
            pose, moved, self._new = self.pose, self._new, False
        self._sent += 1
        streamed, self._streaming = moved and self._streaming, moved and self._timed
        if streamed:
            tracking.to(pose)
            return False
        tracking.to(pose, linear=_ZERO_VELOCITY, angular=_ZERO_VELOCITY)
        if moved:
            self._first = self._sent
        return moved

    def reported_session(self, state: ServoSession | None) -> ServoSession | None:
        """The servo's report, if it is about this pose, or an earlier one of its stream."""
        return state if state is not None and state.sequence >= self._first else None
