"""The parameter node_is_available: whether planner and executor are ready."""

from __future__ import annotations

from types import TracebackType
from typing import Any, Self

from zarm_contract.errors import InvalidRequest, Unavailable
from zarm_ros_bridge.curobo.parameters import AVAILABLE, Parameters
from zarm_ros_bridge.engine import Engine
from zarm_runtime.worker import Worker

_NEEDED = ("planner", "executor")
_PERIOD = 0.5  # interval (s) of the checks


class Availability:
    """Sets the parameter as soon as planner and executor are ready. Use it in `with`."""

    def __init__(self, engine: Engine, parameters: Parameters) -> None:
        self._engine = engine
        self._parameters = parameters
        self._available = False
        self._worker = Worker("node_is_available", self._check, _PERIOD)
        parameters.on_change(AVAILABLE, _refuse)

    def __enter__(self) -> Self:
        self._worker.wake()
        self._worker.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._worker.stop()

    def _check(self) -> None:
        if not self._available and all(map(self._ready, _NEEDED)):
            self._available = True
            self._parameters.set(AVAILABLE, True)

    def _ready(self, service: str) -> bool:
        try:
            return self._engine.client.health(service, timeout=1.0).ready
        except Unavailable:
            return False


def _refuse(_: Any) -> None:
    raise InvalidRequest(f"{AVAILABLE} is read-only; wait until it is true")
