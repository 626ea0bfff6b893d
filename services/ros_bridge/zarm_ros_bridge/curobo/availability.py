"""The parameter node_is_available: whether planner and executor are ready."""

from __future__ import annotations

import threading
from types import TracebackType
from typing import Any, Self

from zarm_contract.errors import InvalidRequest, Unavailable
from zarm_ros_bridge.curobo.parameters import AVAILABLE, Parameters
from zarm_ros_bridge.engine import Engine

_NEEDED = ("planner", "executor")
_PERIOD = 0.5  # interval (s) of the checks


class Availability:
    """Sets the parameter as soon as planner and executor are ready. Use it in `with`."""

    def __init__(self, engine: Engine, parameters: Parameters) -> None:
        self._engine = engine
        self._parameters = parameters
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._wait, name="node_is_available")
        parameters.on_change(AVAILABLE, _refuse)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._ended.set()
        self._thread.join()

    def _wait(self) -> None:
        while not all(map(self._ready, _NEEDED)):
            if self._ended.wait(_PERIOD):
                return
        self._parameters.set(AVAILABLE, True)

    def _ready(self, service: str) -> bool:
        try:
            return self._engine.client.health(service, timeout=1.0).ready
        except Unavailable:
            return False


def _refuse(_: Any) -> None:
    raise InvalidRequest(f"{AVAILABLE} is read-only; wait until it is true")
