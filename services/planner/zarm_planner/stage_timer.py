"""Measures the time of each stage of a plan."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Literal, get_args

from zarm_contract.messages import PlanTimings

Stage = Literal["ik", "search", "shortcut", "timing", "verify", "optimize"]


@dataclass
class StageTimer:
    """Seconds per stage, since it was created."""

    began: float = field(default_factory=time.perf_counter)
    spent: dict[Stage, float] = field(default_factory=dict)

    @contextmanager
    def stage(self, name: Stage) -> Iterator[None]:
        """Add the time of a `with` block to a stage."""
        began = time.perf_counter()
        try:
            yield
        finally:
            self.add(name, time.perf_counter() - began)

    def add(self, name: Stage, seconds: float) -> None:
        """Add time measured elsewhere to a stage."""
        self.spent[name] = self.spent.get(name, 0.0) + seconds

    def timings(self) -> PlanTimings:
        """The time spent so far."""
        stages = {name: self.spent.get(name, 0.0) for name in get_args(Stage)}
        return PlanTimings(**stages, total=time.perf_counter() - self.began)
