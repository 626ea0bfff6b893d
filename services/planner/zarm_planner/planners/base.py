"""The planner interface between the pipeline and the methods that find trajectories."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping
from typing import ClassVar, Literal

from zarm_planner.context import PlanningContext
from zarm_planner.goals.problem import PlanningProblem
from zarm_trajectory.trajectory import TimedTrajectory

GoalKind = Literal["pose", "joints", "waypoints", "groups", "line", "arc", "path"]
"""The `kind` of a goal's message."""

NAMES: Mapping[GoalKind, str] = {"pose": "classic", "joints": "joint_space", "waypoints": "multi_point"}
"""The names of the planners that take every goal."""

Faster = Callable[[float], TimedTrajectory | None]
"""Finds a trajectory faster than the given seconds, or returns None if there is no time left."""


class Planner(ABC):
    """One way to find trajectories. It has no state: one planner serves any number of requests at a time.

    It is never trusted: the pipeline verifies each trajectory in exact geometry before it leaves the process.
    """

    names: ClassVar[Mapping[GoalKind, str]]
    """The kinds of goals that it takes, and its name in requests with such a goal."""
    constrained: ClassVar[bool] = False
    """Whether its trajectories keep a path constraint."""
    moving: ClassVar[bool] = False
    """Whether its trajectories may start in motion, as the problem's `lead_in` does."""

    @abstractmethod
    def trajectories(self, context: PlanningContext, problem: PlanningProblem) -> Iterator[TimedTrajectory]:
        """Trajectories from the start, at rest or in motion, to rest at the goal, for the seed of `context`; the
        fastest first.

        There may be none. The pipeline asks for the next one if one is refused, so later ones stay closer to what is
        known to be free. Raises the deadline's error.
        """

    def attempts(self, context: PlanningContext, problem: PlanningProblem) -> int:
        """How many attempts, each with another seed, may lead to something new."""
        return context.max_attempts

    def faster(self, context: PlanningContext, problem: PlanningProblem) -> Faster:
        """A function that looks for faster trajectories until the deadline of `context`; optional."""
        return lambda _: None
