"""Every message on the bus.

Units are SI (m, rad, s); quaternions are `(x, y, z, w)`; joint vectors follow the order of `joints` in the robot
descriptor; times of day are Unix seconds. Poses are of the descriptor's `tip_link` in its `base_link`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Annotated, Literal, Self

from pydantic import AfterValidator, Field, model_validator

from zarm_contract._model import Message
from zarm_contract.errors import Problem

Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9_.-]{1,64}$")]
"""Letters, digits, `_`, `.` and `-`: a name that is also one chunk of a key expression."""
Joints = Annotated[tuple[float, ...], Field(min_length=1, max_length=32)]
"""One value per joint of the descriptor, in its order."""
Positive = Annotated[float, Field(gt=0)]
NonNegative = Annotated[float, Field(ge=0)]
Scale = Annotated[float, Field(gt=0, le=1)]
Vector3 = tuple[float, float, float]


def _unit(q: tuple[float, float, float, float]) -> tuple[float, float, float, float]:
    norm = math.sqrt(sum(x * x for x in q))
    if abs(norm - 1.0) > 1e-3:
        raise ValueError(f"the quaternion (x, y, z, w) has length {norm:.6g}; normalise it to 1")
    return (q[0] / norm, q[1] / norm, q[2] / norm, q[3] / norm)


Quaternion = Annotated[tuple[float, float, float, float], AfterValidator(_unit)]
"""`(x, y, z, w)`; a length within 1e-3 of one is normalised, any other is refused."""


class Pose(Message):
    """A frame: `position` in m, `orientation` as a unit quaternion `(x, y, z, w)`."""

    position: Vector3
    orientation: Quaternion = (0.0, 0.0, 0.0, 1.0)


class JointState(Message):
    """Measured (or previewed) joints at one moment; `velocity` in rad/s."""

    stamp: float
    joint_names: tuple[str, ...]
    position: Joints
    velocity: Joints

    @model_validator(mode="after")
    def _lengths(self) -> Self:
        _same_length(len(self.joint_names), position=self.position, velocity=self.velocity)
        return self


class Trajectory(Message):
    """A timed motion: `time[i]` s from its start (first 0, strictly increasing), then one row per sample.

    Between samples the motion is the quintic polynomial that meets position, velocity (rad/s) and acceleration
    (rad/s^2) at both ends, as ros2_control's JointTrajectoryController interpolates.
    """

    joint_names: tuple[str, ...]
    time: tuple[NonNegative, ...] = Field(min_length=2)
    position: tuple[Joints, ...]
    velocity: tuple[Joints, ...]
    acceleration: tuple[Joints, ...]

    @property
    def duration(self) -> float:
        """Seconds from the first to the last sample."""
        return self.time[-1]

    @model_validator(mode="after")
    def _shape(self) -> Self:
        if self.time[0] != 0.0:
            raise ValueError("time must start at 0")
        if any(b <= a for a, b in zip(self.time, self.time[1:], strict=False)):
            raise ValueError("time must increase strictly from sample to sample")
        _same_length(len(self.time), position=self.position, velocity=self.velocity, acceleration=self.acceleration)
        for name in ("position", "velocity", "acceleration"):
            rows: tuple[Joints, ...] = getattr(self, name)
            if any(len(row) != len(self.joint_names) for row in rows):
                raise ValueError(f"every row of {name} must hold {len(self.joint_names)} joints, as joint_names does")
        return self


def _same_length(count: int, **columns: Sequence[object]) -> None:
    for name, column in columns.items():
        if len(column) != count:
            raise ValueError(f"{name} has {len(column)} entries where {count} are expected")


# --- planner -----------------------------------------------------------------------------------------------------


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
    pair: tuple[str, str] | None


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


# --- scene -------------------------------------------------------------------------------------------------------


class Cuboid(Message):
    """A box; `size` are the full edge lengths (m) along its own x, y, z."""

    kind: Literal["cuboid"]
    name: Name
    position: Vector3
    orientation: Quaternion = (0.0, 0.0, 0.0, 1.0)
    size: tuple[Positive, Positive, Positive]


class Sphere(Message):
    """A ball around `position`."""

    kind: Literal["sphere"]
    name: Name
    position: Vector3
    radius: Positive


class Capsule(Message):
    """All points within `radius` of a segment of `length` (m) along its own z, centred at `position`."""

    kind: Literal["capsule"]
    name: Name
    position: Vector3
    orientation: Quaternion = (0.0, 0.0, 0.0, 1.0)
    radius: Positive
    length: Positive


class Cylinder(Message):
    """A cylinder with flat ends, `length` (m) along its own z, centred at `position`."""

    kind: Literal["cylinder"]
    name: Name
    position: Vector3
    orientation: Quaternion = (0.0, 0.0, 0.0, 1.0)
    radius: Positive
    length: Positive


SceneObject = Annotated[Cuboid | Sphere | Capsule | Cylinder, Field(discriminator="kind")]

MAX_OBJECTS = 10_000


class Scene(Message):
    """All objects, in the base frame. `revision` grows by one with every change and never goes back."""

    revision: Annotated[int, Field(ge=0)]
    objects: tuple[SceneObject, ...] = Field(default=(), max_length=MAX_OBJECTS)


class AddObjects(Message):
    """Add objects; a name that exists is refused unless `replace`."""

    op: Literal["add"]
    objects: tuple[SceneObject, ...] = Field(min_length=1, max_length=MAX_OBJECTS)
    replace: bool = False


class RemoveObjects(Message):
    """Remove objects by name; an unknown name is refused."""

    op: Literal["remove"]
    names: tuple[Name, ...] = Field(min_length=1)


class ClearScene(Message):
    """Remove every object."""

    op: Literal["clear"]


class LoadScene(Message):
    """Replace every object at once."""

    op: Literal["load"]
    objects: tuple[SceneObject, ...] = Field(max_length=MAX_OBJECTS)


class SceneEdit(Message):
    """One change of the scene, applied whole or not at all."""

    edit: Annotated[AddObjects | RemoveObjects | ClearScene | LoadScene, Field(discriminator="op")]


class SceneEdited(Message):
    """The scene's revision after the edit, and how many objects it holds."""

    revision: Annotated[int, Field(ge=0)]
    count: Annotated[int, Field(ge=0)]


# --- executor ----------------------------------------------------------------------------------------------------

RobotMode = Literal["idle", "running", "stopping", "paused", "fault"]
GoalStatus = Literal["accepted", "running", "paused", "stopping", "succeeded", "cancelled", "aborted"]


class ExecuteRequest(Message):
    """Move the robot: along the plan `plan_id`, along `trajectory`, or (empty request) along the last plan.

    With `trajectory`, `scene_revision` may state the scene it was verified in; a scene that has changed since is refused.
    """

    plan_id: Name | None = None
    trajectory: Trajectory | None = None
    scene_revision: Annotated[int, Field(ge=0)] | None = None

    @model_validator(mode="after")
    def _one_source(self) -> Self:
        if self.plan_id is not None and self.trajectory is not None:
            raise ValueError("give plan_id or trajectory, not both")
        if self.scene_revision is not None and self.trajectory is None:
            raise ValueError("scene_revision belongs to a trajectory; a plan carries its own")
        return self


class Accepted(Message):
    """The goal was accepted and starts now; follow it on `executor/goal/<goal_id>`."""

    goal_id: Name


class GoalState(Message):
    """How one goal is doing. `progress` 0..1 in time; `joint_command` the last command sent (rad); `elapsed` s in motion."""

    goal_id: Name
    plan_id: Name | None
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


class CancelRequest(Message):
    """Cancel one goal, or (empty request) the one that runs. Unknown and finished goals are no error."""

    goal_id: Name | None = None


class ExecutorState(Message):
    """What the robot's owner is doing. `problem` says why it is in `fault`; `missed_ticks` counts since start."""

    mode: RobotMode
    strategy: str
    goal_id: Name | None
    problem: Problem | None
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


class StrategyRequest(Message):
    """Switch to a strategy; an empty request reads."""

    strategy: Name | None = None


# --- every service -----------------------------------------------------------------------------------------------


class Nothing(Message):
    """A request without content: `{}` or no payload at all."""


class Health(Message):
    """How a service is. `activity` says what it is busy with while not `ready`; `uptime` in s."""

    service: Name
    robot: Name
    instance: Name
    ready: bool
    activity: str
    version: str
    contract: str
    robot_hash: str
    uptime: NonNegative
    pid: Annotated[int, Field(gt=0)]
