"""The page's Stop: a thread and a session of its own for each robot, so it works even if anything else hangs."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable

from zarm.connection import Connection, keys_of
from zarm.robot import Robot
from zarm_contract.errors import ZarmError
from zarm_contract.roles import Role
from zarm_runtime.bus import Bus

log = logging.getLogger(__name__)


class Stop:
    """Stops one robot on request; `reported` is called with the result. Use it in `with`."""

    def __init__(
        self, endpoint: str, name: str, role: Role, reported: Callable[[str, ZarmError | None], object]
    ) -> None:
        self._bus = Bus(endpoint, role=role)
        self._robot = Robot(Connection.of(self._bus, keys_of(name)))
        self._reported = reported
        self._pressed, self._ended = threading.Event(), False
        self._thread = threading.Thread(target=self._run, name=f"stop {name}", daemon=True)
        self._thread.start()

    def press(self) -> None:
        """Stop the robot; returns at once."""
        self._pressed.set()

    def close(self) -> None:
        """End the thread and the session."""
        self._ended = True
        self._pressed.set()
        self._thread.join()
        self._bus.close()

    def _run(self) -> None:
        while self._pressed.wait() and not self._ended:
            self._pressed.clear()
            try:
                self._robot.stop()
            except ZarmError as error:
                log.warning("stop failed robot=%s reason=%s", self._robot.name, error)
                self._reported(self._robot.name, error)
            else:
                self._reported(self._robot.name, None)
