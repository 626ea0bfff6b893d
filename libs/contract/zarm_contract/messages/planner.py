"""What the planner is asked, and what it answers."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from zarm_contract._model import Message, ShortMessage
from zarm_contract.messages.motion import (
    Joints,
    Name,
    NonNegative,
    Pose,
    Positive,
    Quaternion,
    Scale,
    Trajectory,
    Vector3,
)
from zarm_contract.messages.scene import SceneRevision


class PoseGoal(Message):
    """Bring the tip to a pose in the base frame."""

    kind: Literal["pose"]
    position: Vector3
    orientation: Quaternion = (0.0, 0.0, 0.0, 1.0)


class JointGoal(Message):
    """Bring the joints to these positions."""

    kind: Literal["joints"]
    position: Joints


class WaypointsGoal(Message):
    """Pass through poses and joint positions in this order without stopping, and rest at the last.

    Each is passed within `position_tolerance` (m) and `angle_tolerance` (rad) of the tip's pose there.
    """

    kind: Literal["waypoints"]
    through: tuple[Annotated[PoseGoal | JointGoal, Field(discriminator="kind")], ...] = Field(
        min_length=1, max_length=100
    )
    position_tolerance: Annotated[float, Field(ge=0.0005, le=0.1)] = 0.005
    angle_tolerance: Annotated[float, Field(ge=0.001, le=0.5)] = 0.02


Goal = Annotated[PoseGoal | JointGoal | WaypointsGoal, Field(discriminator="kind")]

PlannerKind = Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]{0,63}$")]
"""A planner of the planner process: `classic` goes to a pose, `joint_space` to joint positions, `multi_point` through waypoints; `auto`: the goal decides."""


class HeldAxes(Message):
    """Components of the tip's pose that a motion keeps as they are at its start: `[theta_x, theta_y, theta_z, x, y, z]`.

    In the `base` frame they are those of the position and of the rotation vector from the start's orientation; in the
    `tool` frame those of the pose as seen from the tip at the start. They may be off by the tolerances (m, rad).
    """

    axes: tuple[bool, bool, bool, bool, bool, bool]
    frame: Literal["base", "tool"] = "base"
    position_tolerance: Annotated[float, Field(ge=0.0005, le=0.1)] = 0.005
    angle_tolerance: Annotated[float, Field(ge=0.001, le=0.5)] = 0.02


Timeout = Annotated[float, Field(gt=0, le=60)]
Attempts = Annotated[int, Field(ge=1, le=1000)]
OptimizeSeconds = Annotated[float, Field(ge=0, le=30)]
Margin = Annotated[float, Field(ge=0, le=0.2)]


class PlanRequest(Message):
    """Ask for a verified motion. What is left out comes from `planner/settings`; `start` left out is the measured state.

    `request_id` names the request for `planner/cancel`; `timeout` in s is the deadline of the whole planning, and
    `max_attempts` the number of searches after which it gives up earlier. For `optimize_s` s after the first motion is
    found the planner looks for faster ones, as long as no request waits for its turn. The same request with the same `seed`, scene and `optimize_s` 0 gives the same
    motion.
    """

    goal: Goal
    start: Joints | None = None
    planner: PlannerKind | None = None
    held: HeldAxes | None = None
    request_id: Name | None = None
    timeout: Timeout | None = None
    max_attempts: Attempts | None = None
    optimize_s: OptimizeSeconds | None = None
    velocity_scale: Scale | None = None
    acceleration_scale: Scale | None = None
    margin: Margin | None = None
    seed: Annotated[int, Field(ge=0, lt=2**32)] = 0


class PlanTimings(Message):
    """Where the time of a plan went, in seconds, stage by stage."""

    ik: NonNegative
    search: NonNegative
    shorten: NonNegative
    timing: NonNegative
    verify: NonNegative
    optimize: NonNegative
    total: NonNegative


class Plan(Message):
    """A verified motion. `clearance` (m) is the smallest exact distance of the timed motion to the scene and to itself.

    `clearance` is capped at 1 m; nothing thicker than `resolution` (m) was missed between the moments that were looked at.
    `waypoint_times` (s) are when the waypoints of the goal are passed, the last one at the end. `path_length` is the length in joint space (rad, Euclidean). `tip` is the pose at the end.
    It holds only in the scene of `scene_revision`.
    """

    plan_id: Name
    robot: Name
    robot_hash: str
    scene_revision: SceneRevision
    trajectory: Trajectory
    tip: Pose
    clearance: float
    resolution: Positive
    waypoint_times: tuple[NonNegative, ...] = ()
    path_length: NonNegative
    timings: PlanTimings


class CancelPlan(ShortMessage):
    """End the planning of one request, also where it comes up to 10 s after this; unknown and finished ids are no error."""

    request_id: Name


class CancelledPlan(Message):
    """Whether a planning under that id was running."""

    was_running: bool


Device = Literal["auto", "kernels", "cpu", "cuda"]
"""What computes batches: compiled kernels, or pytorch-kinematics on one of its devices; `auto` is a GPU where there is one
and the batch is large enough to gain from it, else kernels."""


class IkRequest(Message):
    """Joint solutions for poses of the tip, those nearest to `near` (default: the measured joints, else home) first."""

    poses: tuple[Pose, ...] = Field(min_length=1, max_length=1000)
    near: Joints | None = None
    max_solutions: Annotated[int, Field(ge=1, le=64)] = 1
    device: Device = "auto"
    collision_free: bool = True
    seed: Annotated[int, Field(ge=0, lt=2**32)] = 0


class IkSolutions(Message):
    """For each pose its solutions, nearest first; empty where none was found."""

    solutions: tuple[tuple[Joints, ...], ...]


class FkRequest(Message):
    """Joint vectors to compute the tip's pose for."""

    joints: tuple[Joints, ...] = Field(min_length=1, max_length=1000)
    device: Device = "auto"


class FkPoses(Message):
    """The tip's pose for each joint vector."""

    poses: tuple[Pose, ...]


class CheckRequest(Message):
    """Joint vectors to check; left out: the measured state. With `spheres`, the distance of each collision sphere as well."""

    joints: tuple[Joints, ...] | None = Field(default=None, min_length=1, max_length=1000)
    spheres: bool = False


class CheckResult(Message):
    """Exact distance of one configuration. `clearance` < 0 is the depth of penetration (m); `pair` names the nearest two.

    `spheres` (m) are the distances of the robot's collision spheres to the scene's objects, link by link in the
    descriptor's order, below 0 inside one and capped at 1 m; those of links on the base and of ignored ones are there too.
    """

    in_collision: bool
    within_limits: bool
    clearance: float
    pair: tuple[str, str] | None = None
    spheres: tuple[float, ...] | None = None


class CheckResults(Message):
    """One result per configuration asked for."""

    results: tuple[CheckResult, ...]


class PlannerSettings(Message):
    """Defaults for plan requests; `margin` (m) is kept to objects on the way, except from a start and to a goal that are nearer.

    Of the ways to reach a pose those that keep it are preferred.
    """

    planner: PlannerKind = "auto"
    timeout: Timeout = 5.0
    max_attempts: Attempts = 100
    optimize_s: OptimizeSeconds = 0.02
    velocity_scale: Scale = 1.0
    acceleration_scale: Scale = 1.0
    margin: Margin = 0.005


class SettingsChange(ShortMessage):
    """Settings to change; what is left out stays. An empty request reads."""

    planner: PlannerKind | None = None
    timeout: Timeout | None = None
    max_attempts: Attempts | None = None
    optimize_s: OptimizeSeconds | None = None
    velocity_scale: Scale | None = None
    acceleration_scale: Scale | None = None
    margin: Margin | None = None
