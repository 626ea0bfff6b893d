"""One goal, from acceptance to its end."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from zarm_contract.errors import ExecutionFailed, Problem
from zarm_contract.messages import GoalState, GoalStatus, GoalTrajectory, Hold, Pose, SceneRevision
from zarm_contract.robot import FaultPolicy
from zarm_executor.monitor import Monitor, NotStopped
from zarm_executor.strategies.base import Progress
from zarm_trajectory.trajectory import TimedTrajectory

_SHOWN_PAST = 0.5
"""How much (s) of the past of a stream is shown with every chunk: where a robot is that is behind."""


@dataclass(frozen=True)
class Outcome:
    """How a goal ends; after a `fault` of the robot nothing moves until it is left, a `latched` one by `reset` alone."""

    status: GoalStatus
    problem: Problem | None = None
    fault: bool = False
    latched: bool = False

    @classmethod
    def fault_of(cls, failures: Sequence[ExecutionFailed], policy: FaultPolicy) -> Outcome:
        """What checks during motion found, or the control loop, first things first; its problem says how the fault is left."""
        latched = policy == "latch" or any(isinstance(failure, NotStopped) for failure in failures)
        found = "; and ".join(failure.problem.message for failure in failures)
        way_out = (
            ", then reset (executor/reset)"
            if latched
            else "; the next goal leaves this fault, once the robot rests and reports its joints"
        )
        problem = failures[0].problem.model_copy(update={"message": found + way_out})
        return cls("aborted", problem, fault=True, latched=latched)


@dataclass(frozen=True)
class Chunk:
    """A piece of a stream: `trajectory` begins at `start` s of it. The next one is due `deadline` s after the moment `received`.

    `received` is on the monotonic clock; `scene` is the revision that the scene had then.
    """

    sequence: int
    start: float
    trajectory: TimedTrajectory
    received: float
    deadline: float
    last: bool
    scene: SceneRevision | None = None


@dataclass
class Goal:
    """A motion along `trajectory`; of a stream `chunk` is the newest one.

    `scene` is the revision of the scene that it was begun in, of a stream that its newest chunk came in; None if nobody had
    told one.
    `verified` is the revision in which the trajectory was verified, None if it was in none; `number` counts its trajectories.
    With `replan` the servo may replace its trajectory, by one to other joints where the pose `tip` is the goal.
    `hold` says why it is held though nobody told it to, since the moment `hold_since`; it `waits` once the robot rests.
    `outcome` is set once it is certain that it ends, and how; `elapsed` counts s in motion.
    """

    goal_id: str
    plan_id: str | None
    trajectory: TimedTrajectory
    monitor: Monitor
    scene: SceneRevision | None = None
    status: GoalStatus = "accepted"
    elapsed: float = 0.0
    pausing: bool = False
    outcome: Outcome | None = None
    chunk: Chunk | None = None
    held_until: float = 0.0
    verified: SceneRevision | None = None
    number: int = 1
    replan: bool = False
    tip: Pose | None = None
    hold: Hold | None = None
    hold_since: float = 0.0
    waits: bool = False

    @property
    def moving(self) -> bool:
        """Whether it is to go on: neither is its end certain, nor is it held."""
        return self.outcome is None and not self.pausing and self.hold is None

    @property
    def complete(self) -> bool:
        """Whether the end of its trajectory is its goal, rather than where to wait for the next chunk."""
        return self.chunk is None or self.chunk.last

    def steer(self, trajectory: TimedTrajectory, chunk: Chunk) -> None:
        """Go on along `trajectory`, which leads to `chunk`."""
        self.trajectory, self.chunk, self.scene = trajectory, chunk, chunk.scene
        self.number += 1
        self.monitor.steer(trajectory)

    def replace(self, trajectory: TimedTrajectory, verified: SceneRevision) -> None:
        """Go on along `trajectory`, which was verified in that scene."""
        self.trajectory, self.scene, self.verified = trajectory, verified, verified
        self.number += 1
        self.monitor.steer(trajectory)

    def late(self, now: float) -> Problem | None:
        """Why it must end because its next chunk is late; the time does not run while it is held."""
        if self.chunk is None or self.chunk.last:
            return None
        waited = now - max(self.chunk.received, self.held_until)
        if waited <= self.chunk.deadline:
            return None
        return Problem(
            code="timeout",
            message=f"no chunk came within {waited:.3f} s of chunk {self.chunk.sequence} (deadline {self.chunk.deadline:g} s); "
            "find out what delayed the client, then start a new stream from where the robot is",
        )

    def state(self, progress: Progress) -> GoalState:
        """What is said about it on the bus when the strategy is as far as `progress`."""
        return GoalState(
            goal_id=self.goal_id,
            plan_id=self.plan_id,
            status=self.status,
            progress=min(max(progress.time / self.trajectory.duration, 0.0), 1.0),
            elapsed=self.elapsed,
            duration=self.trajectory.duration,
            joint_command=tuple(progress.command.tolist()),
            problem=self.outcome.problem if self.outcome else None,
            hold=self.hold,
        )

    def followed(self, joints: tuple[str, ...]) -> GoalTrajectory:
        """Its trajectory as a message, of a stream with no more than `_SHOWN_PAST` before its newest chunk; `joints` names the columns."""
        trajectory = self.trajectory
        if self.chunk is not None:
            trajectory = trajectory.since(self.chunk.start - _SHOWN_PAST)
        start = float(trajectory.time[0])
        return GoalTrajectory(
            goal_id=self.goal_id,
            number=self.number,
            start=start,
            trajectory=trajectory.begun_at(-start).message(joints),
            scene_revision=self.verified,
            replan=self.replan,
            tip=self.tip,
        )

    def before_motion(self) -> GoalState:
        """What is said about it while the robot stands at its start."""
        return self.state(Progress(time=0.0, speed=0.0, command=self.trajectory.start, finished=False))
