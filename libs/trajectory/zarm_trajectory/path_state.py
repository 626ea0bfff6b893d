"""The position and speed of a robot along a trajectory."""

from __future__ import annotations

from typing import NamedTuple


class PathState(NamedTuple):
    """Path time `time` (s), path speed `speed` in [0, 1], and how fast that changes: `rate` (1/s)."""

    time: float
    speed: float
    rate: float = 0.0

    def after(self, dt: float) -> PathState:
        """Where it is at most `dt` s later when the rate stays."""
        speed = min(max(self.speed + self.rate * dt, 0.0), 1.0)
        return PathState(self.time + max(self.speed, speed) * dt, speed, self.rate)
