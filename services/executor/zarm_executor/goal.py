"""A goal: what the robot is asked to do."""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass, replace
from typing import NamedTuple

from zarm_contract.errors import Problem
from zarm_contract.messages import GoalState, GoalTrajectory, Openings, PathConstraint, Pose, SceneRevision, Touch
from zarm_executor.grip_stop import GripStop
from zarm_executor.monitor import Monitor
from zarm_executor.output_stop import OutputStop
from zarm_executor.states import Accepted, State, hold_of, outcome_of, status_of
from zarm_executor.strategies.base import Progress
from zarm_trajectory.trajectory import TimedTrajectory

_SHOWN_PAST = 0.5
"""How much (s) of a stream's past is published with every chunk: a robot that lags behind is there."""


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


class Joined(NamedTuple):
    """A motion of other joints that joins a goal, and what it keeps to."""

    path_constraint: PathConstraint | None


@dataclass(frozen=True)
class Goal:
    """A motion along `trajectory`; for a stream, `chunk` is the newest one.

    `scene` is the scene revision in which the goal began, or in which the newest chunk of a stream arrived; None if
    none was known. `verified` is the revision in which the trajectory was verified, or None; `number` counts its
    trajectories. If `replan` is set, the servo may replace the trajectory, also by one to other joints if the goal is
    the pose `tip`, and one that keeps the `path_constraint`. `segments` are the times (s) at which those of a program begin, `touches` where it may touch objects,
    `openings` those of the grippers with which it was verified, `begun` since when its time counts (s, monotonic), if not from its start, and `stops` where it rests until a gripper has moved or an output is
    switched. `monitor` watches the motion.
    """

    goal_id: str
    plan_id: str | None
    trajectory: TimedTrajectory
    monitor: Monitor
    scene: SceneRevision | None = None
    chunk: Chunk | None = None
    verified: SceneRevision | None = None
    number: int = 1
    replan: bool = False
    tip: Pose | None = None
    path_constraint: PathConstraint | None = None
    segments: tuple[float, ...] = ()
    touches: tuple[Touch, ...] = ()
    openings: Openings = ()
    begun: float | None = None
    stops: tuple[GripStop | OutputStop, ...] = ()

    @property
    def complete(self) -> bool:
        """Whether the trajectory ends at the goal, rather than where the robot waits for the next chunk."""
        return self.chunk is None or self.chunk.last

    def steered(self, trajectory: TimedTrajectory, chunk: Chunk) -> Goal:
        """The goal that continues along `trajectory`, which leads to `chunk`."""
        self.monitor.steer(trajectory)
        return replace(self, trajectory=trajectory, chunk=chunk, scene=chunk.scene, number=self.number + 1)

    def replaced(
        self,
        trajectory: TimedTrajectory,
        verified: SceneRevision,
        openings: Openings,
        monitor: Monitor | None = None,
        *,
        joined: Joined | None = None,
    ) -> Goal:
        """The goal that continues along `trajectory`, which was verified in that scene with these openings, watched by `monitor`
        or as before. If a motion of other joints has `joined`, it is more than a pose of one tip, and is not replanned if that keeps
        to a path constraint of its own.
        """
        monitor = monitor or self.monitor
        monitor.steer(trajectory)
        return replace(
            self,
            trajectory=trajectory,
            scene=verified,
            verified=verified,
            openings=openings,
            monitor=monitor,
            tip=self.tip if joined is None else None,
            replan=self.replan and (joined is None or joined.path_constraint is None),
            number=self.number + 1,
        )

    def late(self, now: float, held_until: float) -> Problem | None:
        """The problem if the goal must end because its next chunk is late; the time before `held_until` (s, monotonic)
        does not count.
        """
        if self.chunk is None or self.chunk.last:
            return None
        waited = now - max(self.chunk.received, held_until)
        if waited <= self.chunk.deadline:
            return None
        return Problem(
            code="timeout",
            message=f"no chunk came within {waited:.3f} s of chunk {self.chunk.sequence} (deadline {self.chunk.deadline:g} s); "
            "find out what delayed the client, then start a new stream from where the robot is",
        )

    def state(self, progress: Progress, state: State, elapsed: float, lag: float | None = None) -> GoalState:
        """The message on the goal in this `state`, at this `progress` of the strategy, after `elapsed` s in motion, while the robot has
        this `lag` (s).
        """
        outcome = outcome_of(state)
        return GoalState(
            goal_id=self.goal_id,
            plan_id=self.plan_id,
            status=status_of(state),
            progress=min(max(progress.time / self.trajectory.duration, 0.0), 1.0),
            elapsed=elapsed,
            duration=self.trajectory.duration,
            joint_command=tuple(progress.command.tolist()),
            lag=lag,
            problem=outcome.problem if outcome else None,
            hold=hold_of(state),
            segment=max(bisect_right(self.segments, progress.time) - 1, 0) if self.segments else None,
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
            path_constraint=self.path_constraint,
            touches=self.touches,
            openings=self.openings,
        )

    def before_motion(self) -> GoalState:
        """The state published while the robot is still at the start."""
        start = Progress(time=0.0, speed=0.0, command=self.trajectory.start, finished=False)
        return self.state(start, Accepted(), 0.0)
