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
"""How much (s) of a stream's past is published with every chunk: a robot that lags behind is there."""


@dataclass(frozen=True)
class Outcome:
    """How a goal ends. After a robot `fault` nothing moves until the fault is left; a `latched` fault can only be left
    by `reset`.
    """

    status: GoalStatus
    problem: Problem | None = None
    fault: bool = False
    latched: bool = False

    @classmethod
    def fault_of(cls, failures: Sequence[ExecutionFailed], policy: FaultPolicy) -> Outcome:
        """The outcome of failed checks during motion or in the control loop, in order; its problem says how to leave
        the fault.
        """
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
    """A piece of a stream: `trajectory` begins at the stream time `start` (s). The next chunk is due `deadline` s after
    `received`.

    `received` is on the monotonic clock; `scene` is the scene revision at that time.
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
    """A motion along `trajectory`; for a stream, `chunk` is the newest one.

    `scene` is the scene revision in which the goal began, or in which the newest chunk of a stream arrived; None if
    none was known. `verified` is the revision in which the trajectory was verified, or None; `number` counts its
    trajectories. If `replan` is set, the servo may replace the trajectory, also by one to other joints if the goal is
    the pose `tip`. `hold` says why the goal is held without having been paused, since `hold_since`; it `waits` once the
    robot is at rest. `outcome` is set once it is certain that, and how, the goal ends. `elapsed` counts s in motion.
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
        """Whether the goal is to go on: its end is not certain yet, and it is not held."""
        return self.outcome is None and not self.pausing and self.hold is None

    @property
    def complete(self) -> bool:
        """Whether the trajectory ends at the goal, rather than where the robot waits for the next chunk."""
        return self.chunk is None or self.chunk.last

    def steer(self, trajectory: TimedTrajectory, chunk: Chunk) -> None:
        """Continue along `trajectory`, which leads to `chunk`."""
        self.trajectory, self.chunk, self.scene = trajectory, chunk, chunk.scene
        self.number += 1
        self.monitor.steer(trajectory)

    def replace(self, trajectory: TimedTrajectory, verified: SceneRevision) -> None:
        """Continue along `trajectory`, which was verified in that scene."""
        self.trajectory, self.scene, self.verified = trajectory, verified, verified
        self.number += 1
        self.monitor.steer(trajectory)

    def late(self, now: float) -> Problem | None:
        """The problem if the goal must end because its next chunk is late; time does not count while it is held."""
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
        """The state published for the goal at this `progress` of the strategy."""
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
        """The trajectory as a message, for a stream with at most `_SHOWN_PAST` before its newest chunk; `joints` names
        the columns.
        """
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
        """The state published while the robot is still at the start."""
        return self.state(Progress(time=0.0, speed=0.0, command=self.trajectory.start, finished=False))
