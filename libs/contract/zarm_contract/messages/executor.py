"""What the executor is asked, and what it says about the robot."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, ValidationInfo, field_validator

from zarm_contract._model import Message, ShortMessage
from zarm_contract.errors import Problem
from zarm_contract.messages.motion import Joints, Name, NonNegative, Positive, Trajectory
from zarm_contract.messages.scene import SceneRevision

RobotMode = Literal["idle", "running", "stopping", "paused", "fault"]
GoalStatus = Literal["accepted", "running", "paused", "stopping", "succeeded", "cancelled", "aborted"]
SpeedScale = Annotated[float, Field(ge=0.05, le=1)]
"""The share of the planned speed at which the robot moves."""


class ExecuteRequest(Message):
    """Move the robot: along the plan `plan_id`, along `trajectory`, or (empty request) along the last plan.

    With `trajectory`, `scene_revision` may state the scene it was verified in; it is refused unless that is the present one.
    A goal that is not at its end makes this one `busy`, unless `preempt`: then that goal is cancelled, and this one starts as
    soon as the robot rests, checked against where it rests.

    `goal_id` names the goal; left out, the executor does. A client that has waited in vain for the answer cancels its goal
    by that name: whichever of the two is read first, the goal does not start any more.
    """

    plan_id: Name | None = None
    trajectory: Trajectory | None = None
    scene_revision: SceneRevision | None = None
    preempt: bool = False
    goal_id: Name | None = None

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


class Accepted(Message):
    """The goal was accepted and starts now; follow it on `executor/goal/<goal_id>`."""

    goal_id: Name


class GoalState(Message):
    """How one goal is doing. `joint_command` is the last command sent (rad), `elapsed` the time in motion (s).

    `duration` (s) is planned, whatever the speed scale: at 0.5 the motion takes twice as long. `progress` 0..1 is the share of
    it that has been reached. Of a stream it is the end of the newest chunk, so that `progress * duration` is its time.
    """

    goal_id: Name
    plan_id: Name | None = None
    status: GoalStatus
    progress: Annotated[float, Field(ge=0, le=1)]
    elapsed: NonNegative
    duration: NonNegative
    joint_command: Joints
    problem: Problem | None = None

    @property
    def done(self) -> bool:
        """Whether this is the goal's last state."""
        return self.status in ("succeeded", "cancelled", "aborted")


class CancelRequest(ShortMessage):
    """Cancel one goal, or (empty request) the one that runs. Unknown and finished goals are no error.

    A goal that is not known yet is not started when it comes.
    """

    goal_id: Name | None = None


class SpeedRequest(ShortMessage):
    """Move at `speed_scale` times the planned speed from now on, also while moving; an empty request reads."""

    speed_scale: SpeedScale | None = None


class Speed(Message):
    """The share of the planned speed at which the robot moves."""

    speed_scale: SpeedScale


class StreamChunk(Message):
    """What a closed-loop planner wants the robot to do next, in place of whatever is left of its earlier chunks.

    A stream is one goal, `goal_id`, which its client chooses; its state is on `executor/goal/<goal_id>`. Its first chunk has
    `sequence` 1 and starts where the robot rests; later ones have higher numbers, and one that comes out of order is dropped.
    Times of a stream run from its beginning as the robot moves (slower under a lower speed scale): the first sample of
    `trajectory` is at `start` s of the stream, and each trajectory ends at rest. The next chunk must be received within
    `deadline` s of this one, else the robot is brought to rest and the goal is aborted (`timeout`); not so after `last`, at
    whose end the goal succeeds. What cannot be done ends the goal as aborted too, with the problem in its state.
    """

    goal_id: Name
    sequence: Annotated[int, Field(ge=1)]
    start: NonNegative
    trajectory: Trajectory
    deadline: Annotated[Positive, Field(le=1)] = 0.1
    last: bool = False


class ExecutorState(Message):
    """What the robot's owner is doing. `problem` says why it is in `fault`; `missed_ticks` counts since start.

    `scene_changed` says that the scene is no longer the one that the goal was begun in: nothing has checked its motion against
    the present one.
    """

    mode: RobotMode
    strategy: str
    goal_id: Name | None = None
    problem: Problem | None = None
    scene_changed: bool = False
    speed_scale: SpeedScale
    missed_ticks: Annotated[int, Field(ge=0)]


class StrategyInfo(Message):
    """One control strategy of this robot; `reason` says why it is not available."""

    name: Name
    available: bool
    reason: str | None = None


class Strategies(Message):
    """The active control strategy and all that this robot knows."""

    active: Name
    strategies: tuple[StrategyInfo, ...]


class StrategyRequest(ShortMessage):
    """Switch to a strategy; an empty request reads."""

    strategy: Name | None = None
