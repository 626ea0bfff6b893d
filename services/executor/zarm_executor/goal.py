"""One motion on its way to an end."""

from __future__ import annotations

from dataclasses import dataclass

from zarm_contract.errors import Problem
from zarm_contract.messages import GoalState, GoalStatus
from zarm_executor.monitor import Monitor
from zarm_executor.path import Path
from zarm_executor.strategies.base import Progress


@dataclass(frozen=True)
class Outcome:
    """How a goal ends; in a `fault` of the robot nothing moves until somebody has looked at it."""

    status: GoalStatus
    problem: Problem | None = None
    fault: bool = False


@dataclass
class Goal:
    """A motion along `path`. `outcome` is set once it is certain that it ends, and how; `elapsed` counts s in motion."""

    goal_id: str
    plan_id: str | None
    path: Path
    monitor: Monitor
    status: GoalStatus = "accepted"
    elapsed: float = 0.0
    pausing: bool = False
    outcome: Outcome | None = None

    @property
    def moving(self) -> bool:
        """Whether it is to go on: neither is its end certain, nor is it held."""
        return self.outcome is None and not self.pausing

    def state(self, progress: Progress) -> GoalState:
        """What is said about it on the bus when the strategy is as far as `progress`."""
        return GoalState(
            goal_id=self.goal_id,
            plan_id=self.plan_id,
            status=self.status,
            progress=min(max(progress.time / self.path.duration, 0.0), 1.0),
            elapsed=self.elapsed,
            duration=self.path.duration,
            joint_command=tuple(progress.command.tolist()),
            problem=self.outcome.problem if self.outcome else None,
        )

    def before_motion(self) -> GoalState:
        """What is said about it while the robot stands at its start."""
        return self.state(Progress(time=0.0, speed=0.0, command=self.path.start, finished=False))
