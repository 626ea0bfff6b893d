"""Requests to the executor, and what it publishes about the robot."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, ValidationInfo, field_validator

from zarm_contract._model import Message, ShortMessage
from zarm_contract.errors import Problem
from zarm_contract.messages.goals import PathConstraint
from zarm_contract.messages.gripper import Openings
from zarm_contract.messages.motion import Joints, Name, NonNegative, Pose, Positive, SequenceNumber, Touch, Trajectory
from zarm_contract.messages.scene import SceneRevision

RobotMode = Literal["idle", "running", "stopping", "paused", "fault"]
GoalStatus = Literal["accepted", "running", "paused", "stopping", "succeeded", "cancelled", "aborted"]
SpeedScale = Annotated[float, Field(ge=0.05, le=1)]
"""The share of the planned speed at which the robot moves."""


class Continuation(Message):
    """The goal `goal_id` is followed along its trajectory of this `number`, see `GoalTrajectory`, up to the path time `at` (s)."""

    goal_id: Name
    number: SequenceNumber
    at: NonNegative


class ExecuteRequest(Message):
    """Start a goal: the plan `plan_id`, any `trajectory`, or with an empty request the last plan.

    `scene_revision` says in which scene a trajectory was verified, and `openings` with which openings of grippers; the request is refused
    if one of them has changed since.
    While another goal is active the answer is `busy`. With `preempt` that goal is cancelled instead; when the robot rests, this
    goal is checked against its position and starts.

    `goal_id` names the goal (default: chosen by the executor). A client that gets no answer cancels its goal by this name: the
    goal then does not start, whichever of the two messages arrives first.

    With `replan` the servo plans again to the end of the trajectory if an object blocks it. The new trajectory
    replaces the old one while the robot moves; if there is no time for that, or a path constraint to keep, the robot stops first. A line, an arc, a path or a program
    is not replanned: the robot brakes on its way, and goes on along it once that is free.

    With `continues` the plan takes over from a running goal, in motion: it begins exactly as that goes on at that time, because it was made
    with the rest of that goal as its `PlanRequest.concurrent`. The goal keeps its id, and ends when all joints rest. The answer is `start_state_mismatch` if
    the robot is already too far, and `stale_plan` if the goal follows another trajectory by now.
    """

    plan_id: Name | None = None
    trajectory: Trajectory | None = None
    scene_revision: SceneRevision | None = None
    preempt: bool = False
    goal_id: Name | None = None
    replan: bool = False
    openings: Openings = ()
    continues: Continuation | None = None

    @field_validator("continues")
    @classmethod
    def _of_a_plan(cls, continues: Continuation | None, info: ValidationInfo) -> Continuation | None:
        if continues is not None and (info.data.get("plan_id") is None or info.data.get("goal_id") is not None):
            raise ValueError("a plan takes over, by its plan_id, and the goal keeps its id: leave goal_id out")
        return continues

    @field_validator("trajectory")
    @classmethod
    def _one_source(cls, trajectory: Trajectory | None, info: ValidationInfo) -> Trajectory | None:
        if trajectory is not None and info.data.get("plan_id") is not None:
            raise ValueError("give plan_id or trajectory, not both")
        return trajectory

    @field_validator("scene_revision")
    @classmethod
    def _of_a_trajectory(cls, revision: str | None, info: ValidationInfo) -> str | None:
        if revision is not None and info.data.get("trajectory", revision) is None:
            raise ValueError("scene_revision belongs to a trajectory; a plan carries its own")
        return revision

    @field_validator("openings")
    @classmethod
    def _with_a_trajectory(cls, openings: Openings, info: ValidationInfo) -> Openings:
        if openings and info.data.get("trajectory", openings) is None:
            raise ValueError("openings belong to a trajectory; a plan carries its own")
        return openings


class Accepted(Message):
    """The goal was accepted and starts. Follow it on `executor/goal/<goal_id>`."""

    goal_id: Name


class GoalTrajectory(Message):
    """The trajectory that the executor follows for a goal; `number` is 1 at its start and increases with every change, also of a stream.

    Sample 0 of `trajectory` is at the path time `start` (s). `scene_revision` is the scene in which it was verified; left out: not verified.
    With `replan` the servo replaces it when something is in its way. `tip` is the pose of a pose goal: any joints that bring the tip
    there will do. Left out: the joints at the end are the goal. A trajectory that replaces it keeps the `path_constraint`. `touches` say where it may touch objects, in path time. `openings` are
    those of the grippers with which it was verified.
    """

    goal_id: Name
    number: SequenceNumber
    start: NonNegative
    trajectory: Trajectory
    scene_revision: SceneRevision | None = None
    replan: bool = False
    tip: Pose | None = None
    path_constraint: PathConstraint | None = None
    touches: tuple[Touch, ...] = ()
    openings: Openings = ()


class ReplaceTrajectory(Message):
    """Follow `trajectory` for the goal `goal_id` from the path time `at` (s) on; the goal goes on under its id.

    `number` is that of the `GoalTrajectory` that is replaced. The new trajectory begins exactly where that one is at `at`, in position,
    velocity and acceleration, and ends at rest. Without `at` it begins where the robot rests, held by its authority. It was
    verified in the scene `scene_revision`, and is free of moving objects up to its time `until` (s), left out: to its end; the robot goes
    no further before the servo allows it. `openings` are those of the grippers with which it was verified. The executor refuses it if the robot has passed `at`, is not held
    (without `at`), or has been told to pause or to end.
    """

    goal_id: Name
    number: SequenceNumber
    at: NonNegative | None = None
    trajectory: Trajectory
    scene_revision: SceneRevision
    until: NonNegative | None = None
    openings: Openings = ()


class Obstruction(Message):
    """What is in the way of a goal: at the path time `time` (s), `link` would touch `object`, of the scene or another link.

    Without `avoidable` it was too late to stop before it when it was found.
    """

    object: str
    link: str
    time: NonNegative
    avoidable: bool = True


class Hold(Message):
    """Why the executor holds a goal; the goal goes on by itself when the reason is gone.

    `obstruction`: something is in the way. `no_guard`: the servo is silent, and the descriptor demands one. `gripper`: the gripper of a
    program's segment moves. `output`: the output of one is being switched.
    """

    reason: Literal["obstruction", "no_guard", "gripper", "output"]
    obstruction: Obstruction | None = None


class GoalState(Message):
    """The state of one goal. `joint_command` is the last command (rad), `elapsed` the time in motion (s).

    `duration` (s) is planned at full speed; at a speed scale of 0.5 the motion takes twice as long. `progress` is the share of
    it that has been reached, 0 to 1. For a stream, `duration` ends with the newest chunk, and `progress * duration` is the time
    of the stream. `hold` says why the robot brakes or waits without a command. While it moves, `tick_lateness` (s) is how late the
    latest tick of the control loop was since the state before, and `lag` (s) by how much the measured joints are behind `joint_command`, which
    under `joint_speed` and `joint_pose` is where they should be by the `delay` in the robot's descriptor. `segment` is the index of a program's segment, see `Plan.segments`.
    """

    goal_id: Name
    plan_id: Name | None = None
    status: GoalStatus
    progress: Annotated[float, Field(ge=0, le=1)]
    elapsed: NonNegative
    duration: NonNegative
    joint_command: Joints
    problem: Problem | None = None
    hold: Hold | None = None
    tick_lateness: NonNegative | None = None
    lag: float | None = None
    segment: Annotated[int, Field(ge=0)] | None = None

    @property
    def done(self) -> bool:
        """Whether this is the goal's last state."""
        return self.status in ("succeeded", "cancelled", "aborted")


class CancelRequest(ShortMessage):
    """Cancel one goal, or with an empty request the active one. Unknown and finished goals are no error.

    A goal that arrives after its cancel does not start.
    """

    goal_id: Name | None = None


class SpeedRequest(ShortMessage):
    """Move at `speed_scale` times the planned speed from now on, also in motion. An empty request only reads."""

    speed_scale: SpeedScale | None = None


class Speed(Message):
    """The share of the planned speed at which the robot moves."""

    speed_scale: SpeedScale


class StreamChunk(Message):
    """The next part of a closed-loop motion; it replaces the rest of the chunks before.

    A stream is one goal with the `goal_id` that its client chooses. `sequence` is 1 for the first chunk, which starts where the
    robot rests, and increases; a chunk out of order is dropped. Sample 0 of `trajectory` is at `start` (s) of the stream, whose
    time runs as the robot moves: slower under a lower speed scale. Each trajectory ends at rest. If no chunk arrives within
    `deadline` (s) of this one, the robot brakes and the goal ends `aborted` with `timeout`. A chunk with `last` has no
    deadline; at its end the goal has succeeded. A chunk that cannot be executed ends the goal `aborted` too.

    With `begin_at` (Unix s) in the first chunk the time of the stream counts from that time of day, at most 0.08 s before the robot begins: several
    robots whose clocks agree then move in step.
    """

    goal_id: Name
    sequence: SequenceNumber
    start: NonNegative
    trajectory: Trajectory
    deadline: Annotated[Positive, Field(le=1)] = 0.1
    last: bool = False
    begin_at: float | None = None


class ExecutorState(Message):
    """What the executor does. `problem` says why it is in `fault`; `missed_ticks` counts since the start.

    `scene_changed`: the scene was edited since the goal started, and nothing has checked the rest of the motion against it.
    `guarded`: a servo does, against every scene.
    """

    mode: RobotMode
    strategy: str
    goal_id: Name | None = None
    problem: Problem | None = None
    scene_changed: bool = False
    guarded: bool = False
    speed_scale: SpeedScale
    missed_ticks: Annotated[int, Field(ge=0)]


class StrategyInfo(Message):
    """One control strategy; `reason` says why it is not available."""

    name: Name
    available: bool
    reason: str | None = None


class Strategies(Message):
    """The active control strategy, and all strategies."""

    active: Name
    strategies: tuple[StrategyInfo, ...]


class StrategyRequest(ShortMessage):
    """Switch to a strategy. An empty request only reads."""

    strategy: Name | None = None
