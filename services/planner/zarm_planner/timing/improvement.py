"""Improves motions while there is time: other routes, and more shortcuts on the best motions so far."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from zarm_geometry.robot_model import RobotModel
from zarm_geometry.world import World
from zarm_planner.deadline import Deadline
from zarm_planner.timing.averaging import DEVIATION
from zarm_planner.timing.lead_in import LeadIn
from zarm_planner.timing.smoothing import Smoothing
from zarm_trajectory.arrays import Array
from zarm_trajectory.limits import Limits
from zarm_trajectory.trajectory import TimedTrajectory

GAIN = 0.005
"""A motion must save at least this share of the best one to be worth a verification."""
_ATTEMPTS = 500
"""Shortcuts per round, on a new route and on the best motion; about a millisecond on MotionBenchMaker's problems."""
_KEPT = 4
"""Motions kept, as alternatives if the best one is refused."""

Routes = Callable[[int], tuple[Array, Sequence[int]] | None]
"""The k-th route: a free path (n, dof) from the start to a goal, and the rows of it that the motion has to pass; None
if there is none. The same k gives the same route.
"""


@dataclass
class Improvement:
    """The search for a faster motion. The same seed tries the same motions; time decides how many.

    Every motion is one of `smoothing.smooth_path`, along one of `routes`.
    """

    model: RobotModel
    world: World
    limits: Limits
    dt: float
    routes: Routes
    seed: int
    deviation: float = DEVIATION
    lead_in: LeadIn | None = None
    _round: int = field(default=0, init=False)
    _best: list[Smoothing] = field(default_factory=list, init=False)
    _given: tuple[Smoothing, float] | None = field(default=None, init=False)

    def faster_than(self, duration: float, deadline: Deadline) -> TimedTrajectory | None:
        """A motion that lasts at most `(1 - GAIN) * duration` s; None if `deadline` came before one was found.

        Asking for one faster than the last answer means that this was of no use: it is not developed further. Raises
        what `routes` raises, and InvalidRequest if a motion is longer than `trajectory.MAX_SAMPLES`.
        """
        wanted = (1.0 - GAIN) * duration
        if self._given is not None and self._given[1] < duration:
            self._best.remove(self._given[0])
        self._given = None
        while not deadline.passed:
            self._develop(deadline)
            if self._best and self._best[0].duration <= wanted:
                trajectory = self._best[0].trajectory()
                if trajectory.duration <= wanted:
                    self._given = self._best[0], trajectory.duration
                    return trajectory
        return None

    def _develop(self, deadline: Deadline) -> None:
        """One round of optimisation: search another route, and shortcut the best motion further."""
        seed = self.seed + 2 * self._round
        if (route := self.routes(self._round)) is not None:
            path, vias = route
            new = Smoothing(
                self.model,
                self.world,
                path,
                self.limits,
                self.dt,
                vias=vias,
                deviation=self.deviation,
                lead_in=self.lead_in,
            )
            new.shortcut(_ATTEMPTS, seed, deadline)
            self._best.append(new)
        if self._best:
            self._best.sort(key=lambda smoothing: smoothing.duration)
            del self._best[_KEPT:]
            self._best[0].shortcut(_ATTEMPTS, seed + 1, deadline)
        self._round += 1
