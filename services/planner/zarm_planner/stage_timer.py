"""Measures the time of each stage of a plan."""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from types import TracebackType
from typing import Literal, get_args

from zarm_contract.messages import PlanTimings

Stage = Literal["ik", "search", "shortcut", "timing", "verify", "optimize"]
_STAGES: tuple[Stage, ...] = get_args(Stage)


@dataclass
class StageTimer:
    """Seconds per stage, since it was created."""

    began: float = field(default_factory=time.perf_counter)
    spent: dict[Stage, float] = field(default_factory=dict)

    def stage(self, name: Stage) -> _Timed:
        """Add the time of a `with` block to a stage."""
        return _Timed(self, name)

    def add(self, name: Stage, seconds: float) -> None:
        """Add time measured elsewhere to a stage."""
        self.spent[name] = self.spent.get(name, 0.0) + seconds

    def timings(self) -> PlanTimings:
        """The time spent so far."""
        stages = {name: self.spent.get(name, 0.0) for name in _STAGES}
        return PlanTimings(**stages, total=time.perf_counter() - self.began)


class _Timed:
    """One block of a stage; a generator's context manager takes several times as long."""

    __slots__ = ("_began", "_stage", "_timer")

    def __init__(self, timer: StageTimer, stage: Stage) -> None:
        self._timer, self._stage = timer, stage

    def __enter__(self) -> None:
        self._began = time.perf_counter()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._timer.add(self._stage, time.perf_counter() - self._began)
