"""The page's Stop: a thread and a session of its own for each robot, so it works even if anything else hangs."""

from __future__ import annotations

import logging
from collections.abc import Callable

from zarm.connection import Connection, keys_of
from zarm.robot import Robot
from zarm_contract.errors import ZarmError
from zarm_contract.roles import Role
from zarm_runtime.bus import Bus
from zarm_runtime.worker import Worker

log = logging.getLogger(__name__)


class Stop:
    """Stops one robot on request; `reported` is called with the result. Use it in `with`."""

    def __init__(
        self, endpoint: str, name: str, role: Role, reported: Callable[[str, ZarmError | None], object]
    ) -> None:
        self._bus = Bus(endpoint, role=role)
        self._robot = Robot(Connection.of(self._bus, keys_of(name)))
        self._reported = reported
        self._worker = Worker(f"stop {name}", self._stop)
        self._worker.start()

    def press(self) -> None:
        """Stop the robot; returns at once."""
        self._worker.wake()

    def close(self) -> None:
        """End the thread and the session."""
        self._worker.stop()
        self._bus.close()

    def _stop(self) -> None:
        try:
            self._robot.stop()
        except ZarmError as error:
            log.warning("stop failed robot=%s reason=%s", self._robot.name, error)
            self._reported(self._robot.name, error)
        else:
            self._reported(self._robot.name, None)
