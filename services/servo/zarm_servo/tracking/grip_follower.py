"""Moves a gripper as a chunk says."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from concurrent.futures import Executor

from zarm_contract.errors import Problem, ZarmError
from zarm_contract.messages import GripperRequest
from zarm_servo.tracking.reference import Reference

log = logging.getLogger(__name__)

MoveGripper = Callable[[GripperRequest], object]
"""Asks the executor for a motion of a gripper. Raises its refusal."""
_CHANGE = 0.001
"""A command is sent when the opening has changed by this much (m)."""


class GripFollower:
    """Sends the openings of chunks through `move`, run in `pool`, one at a time and the newest next; a refusal is told to `refused`."""

    def __init__(self, move: MoveGripper, pool: Executor, refused: Callable[[Problem], None]) -> None:
        self._move, self._pool, self._refused = move, pool, refused
        self._turn = threading.Lock()
        self._wanted: tuple[str, float] | None = None
        self._sent: tuple[str, float] | None = None
        self._under_way = False

    def follow(self, reference: Reference, time: float) -> None:
        """Command what the chunk says for a `time` (s), if that is new; while a command is under way, when that has been answered."""
        if reference.gripper is not None:
            self._wanted = reference.gripper, reference.opening(time)
            self._send()

    def _send(self) -> None:
        with self._turn:
            wanted, sent = self._wanted, self._sent
            if wanted is None or self._under_way or (sent is not None and _same(wanted, sent)):
                return
            self._sent, self._under_way = wanted, True
        self._pool.submit(self._ask, GripperRequest(gripper=wanted[0], width=wanted[1], preempt=True))

    def _ask(self, request: GripperRequest) -> None:
        try:
            self._move(request)
        except ZarmError as error:
            log.warning("the gripper does not follow gripper=%s reason=%s", request.gripper, error)
            self._refused(error.problem)
        finally:
            self._under_way = False
        self._send()


def _same(one: tuple[str, float], other: tuple[str, float]) -> bool:
    return one[0] == other[0] and abs(one[1] - other[1]) < _CHANGE
