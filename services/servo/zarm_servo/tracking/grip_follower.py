"""Moves a gripper as a chunk says."""

from __future__ import annotations

import logging
from collections.abc import Callable
from concurrent.futures import Executor, Future

from zarm_contract.errors import Problem, ZarmError
from zarm_contract.messages import GripperRequest
from zarm_servo.tracking.reference import Reference

log = logging.getLogger(__name__)

MoveGripper = Callable[[GripperRequest], object]
"""Asks the executor for a motion of a gripper. Raises its refusal."""
_CHANGE = 0.001
"""A command is sent when the opening has changed by this much (m)."""


class GripFollower:
    """Sends the openings of chunks through `move`, run in `pool`, one at a time; a refusal is told to `refused`."""

    def __init__(self, move: MoveGripper, pool: Executor, refused: Callable[[Problem], None]) -> None:
        self._move, self._pool, self._refused = move, pool, refused
        self._sent: tuple[str, float] | None = None
        self._under_way: Future[None] | None = None

    def follow(self, reference: Reference, time: float) -> None:
        """Command what the chunk says for a `time` (s), if that is new."""
        if reference.gripper is None or (self._under_way is not None and not self._under_way.done()):
            return
        opening = reference.opening(time)
        before, sent = self._sent or (None, 0.0)
        if reference.gripper == before and abs(opening - sent) < _CHANGE:
            return
        self._sent = reference.gripper, opening
        self._under_way = self._pool.submit(
            self._ask, GripperRequest(gripper=reference.gripper, width=opening, preempt=True)
        )

    def _ask(self, request: GripperRequest) -> None:
        try:
            self._move(request)
        except ZarmError as error:
            log.warning("the gripper does not follow gripper=%s reason=%s", request.gripper, error)
            self._refused(error.problem)
