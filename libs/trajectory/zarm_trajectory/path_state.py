"""The position and speed of a robot along a trajectory."""

from __future__ import annotations

from typing import NamedTuple


class PathState(NamedTuple):
    """Path time `time` (s), path speed `speed` in [0, 1], and its rate of change `rate` (1/s)."""

    time: float
    speed: float
    rate: float = 0.0

    def after(self, dt: float) -> PathState:
        """An upper bound on the state `dt` s later, at a constant rate."""
        speed = min(max(self.speed + self.rate * dt, 0.0), 1.0)
        return PathState(self.time + max(self.speed, speed) * dt, speed, self.rate)
