"""What the planner is asked, and what it answers."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from zarm_contract._model import Message
from zarm_contract.messages.motion import Joints, Name, NonNegative, Pose, Quaternion, Scale, Trajectory, Vector3


class PoseGoal(Message):
    """Bring the tip to a pose in the base frame."""

    kind: Literal["pose"]
    position: Vector3
    orientation: Quaternion = (0.0, 0.0, 0.0, 1.0)


class JointGoal(Message):
    """Bring the joints to these positions."""

    kind: Literal["joints"]
    position: Joints


Goal = Annotated[PoseGoal | JointGoal, Field(discriminator="kind")]


class PlanRequest(Message):
    """Ask for a verified motion. What is left out comes from `planner/settings`; `start` left out is the measured state.

    `request_id` names the request for `planner/cancel`; `timeout` in s is the deadline of the whole planning.
    The same request with the same `seed` and scene gives the same motion.
    """

    goal: Goal
    start: Joints | None = None
    request_id: Name | None = None
    timeout: Annotated[float, Field(gt=0, le=60)] | None = None
    velocity_scale: Scale | None = None
    acceleration_scale: Scale | None = None
    seed: Annotated[int, Field(ge=0, lt=2**32)] = 0


class PlanTimings(Message):
    """Where the time of a plan went, in seconds, stage by stage."""

    ik: NonNegative
    search: NonNegative
    shorten: NonNegative
    timing: NonNegative
    verify: NonNegative
    total: NonNegative


class Plan(Message):
    """A verified motion. `clearance` (m) is the smallest exact distance of the timed motion to the scene and to itself.

    `clearance` is capped at 1 m. `path_length` is the length in joint space (rad, Euclidean). `tip` is the pose at the end.
    """

    plan_id: Name
    robot: Name
    robot_hash: str
    scene_revision: Annotated[int, Field(ge=0)]
    trajectory: Trajectory
    tip: Pose
    clearance: float
    path_length: NonNegative
    timings: PlanTimings


class CancelPlan(Message):
    """End the planning of one request; unknown and finished ids are no error."""

    request_id: Name


class CancelledPlan(Message):
    """Whether a planning under that id was running."""

    was_running: bool


class IkRequest(Message):
    """Joint solutions for poses of the tip, those nearest to `near` (default: the measured joints, else home) first."""

    poses: tuple[Pose, ...] = Field(min_length=1, max_length=1000)
    near: Joints | None = None
    max_solutions: Annotated[int, Field(ge=1, le=64)] = 1
    collision_free: bool = True
    seed: Annotated[int, Field(ge=0, lt=2**32)] = 0


class IkSolutions(Message):
    """For each pose its solutions, nearest first; empty where none was found."""

    solutions: tuple[tuple[Joints, ...], ...]


class FkRequest(Message):
    """Joint vectors to compute the tip's pose for."""

    joints: tuple[Joints, ...] = Field(min_length=1, max_length=1000)


class FkPoses(Message):
    """The tip's pose for each joint vector."""

    poses: tuple[Pose, ...]


class CheckRequest(Message):
    """Joint vectors to check; left out: the measured state."""

    joints: tuple[Joints, ...] | None = Field(default=None, min_length=1, max_length=1000)


class CheckResult(Message):
    """Exact distance of one configuration. `clearance` < 0 is the depth of penetration (m); `pair` names the nearest two."""

    in_collision: bool
    within_limits: bool
    clearance: float
    pair: tuple[str, str] | None = None


class CheckResults(Message):
    """One result per configuration asked for."""

    results: tuple[CheckResult, ...]


class PlannerSettings(Message):
    """Defaults for plan requests; `margin` (m) is kept free around the robot by search and goal states."""

    timeout: Annotated[float, Field(gt=0, le=60)] = 5.0
    velocity_scale: Scale = 1.0
    acceleration_scale: Scale = 1.0
    margin: Annotated[float, Field(ge=0, le=0.2)] = 0.005


class SettingsChange(Message):
    """Settings to change; what is left out stays. An empty request reads."""

    timeout: Annotated[float, Field(gt=0, le=60)] | None = None
    velocity_scale: Scale | None = None
    acceleration_scale: Scale | None = None
    margin: Annotated[float, Field(ge=0, le=0.2)] | None = None
