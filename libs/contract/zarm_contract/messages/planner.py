"""Requests to the planner, and its replies."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, ValidationInfo, field_validator

from zarm_contract._model import Message, ShortMessage
from zarm_contract.errors import Problem
from zarm_contract.messages.goals import Goal, GroupName, PathConstraint, PoseTolerance, TipFrame
from zarm_contract.messages.gripper import Openings, PlannedGrip
from zarm_contract.messages.motion import (
    Joints,
    Name,
    NonNegative,
    Pose,
    Positive,
    Scale,
    Touch,
    Trajectory,
    Vector3,
    same_length,
)
from zarm_contract.messages.output import OutputRequest
from zarm_contract.messages.scene import SceneRevision

PlannerKind = Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]{0,63}$")]
"""A planner of the planner process: `classic` goes to a pose, `joint_space` to joint positions, `multi_point` through waypoints, `cartesian` along lines, arcs and paths; `auto`: the goal decides."""


class StartState(Message):
    """A state of the joints in motion: `position` (rad), `velocity` (rad/s) and `acceleration` (rad/s²)."""

    position: Joints
    velocity: Joints
    acceleration: Joints

    @field_validator("velocity", "acceleration")
    @classmethod
    def _one_per_joint(cls, values: tuple[float, ...], info: ValidationInfo) -> tuple[float, ...]:
        same_length(values, info, "position")
        return values


Timeout = Annotated[float, Field(gt=0, le=60)]
Attempts = Annotated[int, Field(ge=1, le=1000)]
OptimizeSeconds = Annotated[float, Field(ge=0, le=30)]
Margin = Annotated[float, Field(ge=0, le=0.2)]


class PlanRequest(Message):
    """Ask for a verified trajectory. What is left out comes from `planner/settings`; `start` (rad) from the measured joints.

    With `start_state` in place of `start` the trajectory begins in motion, exactly in that state, and is continuous with it in
    position, velocity and acceleration. The state must be inside the limits, and the robot able to brake from it without a
    collision. A path constraint is then refused.
    `request_id` names the request for `planner/cancel`. `timeout` (s) is the deadline of the whole request; `max_attempts`
    bounds the number of searches. After the first plan the planner looks for faster ones for `optimize_s` (s), as long as no
    other request waits. `margin` (m) is the distance to keep from objects, `self_margin` (m) that between the robot's
    own links; left out, it is the descriptor's. Two links that are nearer in nearly all configurations keep the distance that they can. Scales are shares of the velocity and acceleration
    limits. With `optimize_s` 0 the same request, scene and `seed` give the same trajectory. With `publish` false only the
    requester gets the plan: it is not on `planner/plans`, and cannot be executed by its id. `openings` are those of the grippers, by
    default the measured ones, where one moves that to which it moves, and open before any are measured. With a `group` of the
    descriptor only its joints move: a joint goal gives these alone, and poses are those of its tip. The others stand as at the start.
    A robot with several tips needs a group for poses.

    `concurrent` is a motion that other joints make at the same time: a plan for another group, or what is left of a goal, see
    `ExecuteRequest.continues`. The trajectory then has both, from the beginning of that motion on: those joints follow it, at its own speed, and the group
    starts as soon as all stay apart, at the latest when they rest.
    """

    goal: Goal
    group: GroupName | None = None
    start: Joints | None = None
    start_state: StartState | None = None
    planner: PlannerKind | None = None
    path_constraint: PathConstraint | None = None
    request_id: Name | None = None
    timeout: Timeout | None = None
    max_attempts: Attempts | None = None
    optimize_s: OptimizeSeconds | None = None
    velocity_scale: Scale | None = None
    acceleration_scale: Scale | None = None
    margin: Margin | None = None
    self_margin: Margin | None = None
    seed: Annotated[int, Field(ge=0, lt=2**32)] = 0
    publish: bool = True
    openings: Openings = ()
    concurrent: Trajectory | None = None

    @field_validator("start_state")
    @classmethod
    def _one_start(cls, state: StartState | None, info: ValidationInfo) -> StartState | None:
        if state is not None and info.data.get("start") is not None:
            raise ValueError("start is given too; give one of them")
        return state


class PlanTimings(Message):
    """How long each stage of planning took (s)."""

    ik: NonNegative
    search: NonNegative
    shortcut: NonNegative
    timing: NonNegative
    verify: NonNegative
    optimize: NonNegative
    total: NonNegative


POSE_COMPONENTS = ("theta_x", "theta_y", "theta_z", "x", "y", "z")
"""The components of a pose, in the order of all that bounds or holds them."""
PoseDeviation = tuple[float, float, float, float, float, float]
"""How far a pose is from another: `[theta_x, theta_y, theta_z, x, y, z]` in rad and m."""


class ToolMotion(Message):
    """How the tip moves along a `line`, `arc` or `path` of `length` (m): with at most `speed` (m/s), which it keeps on the share
    `speed_share` (0..1) of its way, or turns with `rotational_speed` (rad/s). Elsewhere the joints or its acceleration demand less.
    """

    length: NonNegative
    speed: Positive
    rotational_speed: Positive
    speed_share: Annotated[float, Field(ge=0, le=1)]


class TooNear(Message):
    """A link comes nearer to an object or another link than the `margin` (m): `distance` m at `time` s of the trajectory."""

    pair: tuple[str, str]
    distance: float
    margin: Positive
    time: NonNegative


class PlannedSegment(Message):
    """A segment of a program: what it does, and when it begins and ends (s). What is attached or detached changes at its
    beginning. With `grip` a gripper moves, with `output` one is switched, and the robot waits for it.
    """

    action: Literal["move", "wait", "speed", "attach", "detach", "grip", "set_output"]
    name: Name | None = None
    begin: NonNegative
    end: NonNegative
    grip: PlannedGrip | None = None
    output: OutputRequest | None = None


class PlanTorque(ShortMessage):
    """Where a plan comes nearest to the effort limit of a joint in the URDF: it needs `share` (0..1) of it at `time` (s).

    `stretch` is by how much the plan was slowed down to keep the limits: 1 if that was not needed, 1.2 if it takes 1.2 times as long.
    """

    joint: Name
    share: NonNegative
    time: NonNegative
    stretch: Annotated[float, Field(ge=1)] = 1.0


class Plan(Message):
    """A verified trajectory, valid only in the scene of `scene_revision` and for the robot of `robot_hash`.

    `clearance` (m) is the smallest exact distance of the timed trajectory to the scene and of the robot to itself, at most
    1 m. `too_near` names what comes nearer than the margins, usually because it does so at the start or goal. Nothing thicker than `resolution` (m) can be missed between two checks. `waypoint_times` (s) say when each waypoint is
    passed. `path_length` is the length in joint space (rad, Euclidean). `tip` is the pose at the end. `selected_goal_index`
    says which pose of a pose goal that is: 0 is its own, k its k-th alternative. With waypoints it belongs to the last one.
    It is left out if the motion ends at a joint goal. `goal_deviation` says how a goal's tolerance is used: the components
    `[theta_x, theta_y, theta_z, x, y, z]` (rad, m) by which the tip is off that pose, see `PoseTolerance`. `path_constraint` is what it keeps to. `tool` is given for lines,
    arcs and paths, `segments` for programs, and `touches` where objects may be touched: `clearance` does not count these there. It holds
    for grippers with these `openings`, within 1 mm. `torque` is left out if the URDF does not state the inertia of each link. With a `problem` it is the part of a program before the segment that fails, see `ProgramRequest`.
    """

    plan_id: Name
    robot: Name
    robot_hash: str
    scene_revision: SceneRevision
    trajectory: Trajectory
    tip: Pose
    selected_goal_index: Annotated[int, Field(ge=0)] | None = None
    goal_deviation: PoseDeviation | None = None
    path_constraint: PathConstraint | None = None
    tool: ToolMotion | None = None
    segments: tuple[PlannedSegment, ...] = ()
    touches: tuple[Touch, ...] = ()
    openings: Openings = ()
    torque: PlanTorque | None = None
    problem: Problem | None = None
    clearance: float
    too_near: tuple[TooNear, ...] = ()
    resolution: Positive
    waypoint_times: tuple[NonNegative, ...] = ()
    path_length: NonNegative
    timings: PlanTimings


class CancelPlan(ShortMessage):
    """End the planning of one request. Unknown and finished ids are no error.

    A request that arrives up to 10 s after its cancel is ended as well.
    """

    request_id: Name


class CancelledPlan(Message):
    """Whether a request with that id was being planned."""

    was_running: bool


Device = Literal["auto", "kernels", "cpu", "cuda"]
"""What computes batches: compiled kernels, or pytorch-kinematics on one of its devices; `auto` is a GPU where there is one
and the batch is large enough to gain from it, else kernels."""


class IkRequest(Message):
    """Inverse kinematics: joint solutions for tip poses, nearest to `near` first (rad; default: the measured joints, else home).

    With `collision_free` only solutions without collision count. `device` says what computes the batch. `tolerance` and `tip` as in
    `PoseGoal`, for all poses; kernels compute them. With a `group` the poses are those of its tip and the solutions its joints alone; `near`
    gives all joints, of which the others stand.
    """

    poses: tuple[Pose, ...] = Field(min_length=1, max_length=1000)
    tolerance: PoseTolerance | None = None
    tip: TipFrame | None = None
    group: GroupName | None = None
    near: Joints | None = None
    max_solutions: Annotated[int, Field(ge=1, le=64)] = 1
    device: Device = "auto"
    collision_free: bool = True
    seed: Annotated[int, Field(ge=0, lt=2**32)] = 0


class IkSolutions(Message):
    """The solutions (rad) of each pose, nearest first; an empty list if there is none."""

    solutions: tuple[tuple[Joints, ...], ...]


class FkRequest(Message):
    """Forward kinematics: the tip pose for each joint vector (rad) of the robot; with a `group`, that of its tip, or that of another frame of the robot,
    `tip`.
    """

    joints: tuple[Joints, ...] = Field(min_length=1, max_length=1000)
    group: GroupName | None = None
    tip: TipFrame | None = None
    device: Device = "auto"


class FkPoses(Message):
    """The tip pose for each joint vector."""

    poses: tuple[Pose, ...]


class CheckRequest(Message):
    """Check joint vectors (rad; default: the measured joints) for collision. `spheres` asks for the distance of each collision sphere.

    `points` asks between which points the clearance is measured, `torque` which torques hold the robot there.
    """

    joints: tuple[Joints, ...] | None = Field(default=None, min_length=1, max_length=1000)
    spheres: bool = False
    points: bool = False
    torque: bool = False


class InverseDynamicsRequest(Message):
    """The torques of motions: `joints` (rad) with `velocity` (rad/s) and `acceleration` (rad/s²), row by row; without these the robot stands still."""

    joints: tuple[Joints, ...] = Field(min_length=1, max_length=1000)
    velocity: tuple[Joints, ...] | None = Field(default=None, max_length=1000)
    acceleration: tuple[Joints, ...] | None = Field(default=None, max_length=1000)

    @field_validator("velocity", "acceleration")
    @classmethod
    def _one_per_row(cls, rows: tuple[Joints, ...] | None, info: ValidationInfo) -> tuple[Joints, ...] | None:
        if rows is not None:
            same_length(rows, info, "joints")
        return rows


class InverseDynamics(Message):
    """The `torque` (Nm, N if prismatic) of each joint at each row, with what the robot carries, and its `effort`, left out of a joint whose URDF states none
    that can be. Both are left out if the URDF does not state the inertia of each link.
    """

    torque: tuple[Joints, ...] | None = None
    effort: tuple[Positive | None, ...] | None = None


class HoldingTorque(ShortMessage):
    """The `torque` (Nm, N if prismatic) that holds a joint still against gravity, and its `effort`, left out where the URDF states none that can be."""

    torque: float
    effort: Positive | None = None


class CheckResult(Message):
    """Exact distance of one joint vector. `pair` names the two nearest links or objects.

    A negative `clearance` is a penetration depth (m). `spheres` (m) are the distances from the collision spheres of the robot
    to the scene, link by link in the order of the descriptor; negative inside an object, at most 1 m. They include links that
    are fixed to the base and links whose collisions are ignored. `points` (m, in the base frame) are the nearest ones of the
    pair, left out where the two overlap. `holding` has the joints in the descriptor's order, with what the robot carries; it is left out if the
    URDF does not state the inertia of each link.
    """

    in_collision: bool
    within_limits: bool
    clearance: float
    pair: tuple[str, str] | None = None
    spheres: tuple[float, ...] | None = None
    points: tuple[Vector3, Vector3] | None = None
    holding: tuple[HoldingTorque, ...] | None = None


class CheckResults(Message):
    """One result for each joint vector."""

    results: tuple[CheckResult, ...]


class PlannerSettings(Message):
    """Defaults for plan requests; see `PlanRequest`.

    `margin` (m) is kept on the way, but a start and a goal may be nearer to an object. Goal configurations that keep it are
    preferred.
    """

    planner: PlannerKind = "auto"
    timeout: Timeout = 5.0
    max_attempts: Attempts = 100
    optimize_s: OptimizeSeconds = 0.02
    velocity_scale: Scale = 1.0
    acceleration_scale: Scale = 1.0
    margin: Margin = 0.005


class SettingsChange(ShortMessage):
    """The settings to change; the others stay. An empty request only reads."""

    planner: PlannerKind | None = None
    timeout: Timeout | None = None
    max_attempts: Attempts | None = None
    optimize_s: OptimizeSeconds | None = None
    velocity_scale: Scale | None = None
    acceleration_scale: Scale | None = None
    margin: Margin | None = None


class Planners(Message):
    """The names of planners that a request or the settings may give."""

    names: tuple[PlannerKind, ...]
