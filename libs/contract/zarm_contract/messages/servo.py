"""The servo: how far a running goal may go, and sessions in which the robot follows a live target."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

from pydantic import Field

from zarm_contract._model import Message, ShortMessage
from zarm_contract.errors import Problem
from zarm_contract.messages.executor import Obstruction
from zarm_contract.messages.goals import GroupName, PoseTolerance
from zarm_contract.messages.motion import (
    JointNames,
    Joints,
    Name,
    NonNegative,
    Pose,
    Positive,
    Quaternion,
    Scale,
    SequenceNumber,
    Vector3,
)
from zarm_contract.messages.scene import SceneRevision

Limiting = Literal["free", "slowing", "blocked", "singularity", "joint_limit", "target_stale"]
"""What limits a session: nothing; what is near slows it; what is too near blocks it; a singularity; a joint limit; no fresh target."""


class Authority(ShortMessage):
    """How far the goal `goal_id` may go: the robot comes to rest before the path time `until` (s); left out: to the end.

    `trajectory` is the number of the `GoalTrajectory` that was checked, and `scene_revision` the scene that it was checked in.
    `obstruction` says what ends the authority. Without a goal the message shows that the servo is alive. It is repeated
    several times a second; a servo that is silent for `execution.guard_timeout` counts as gone. `sequence`
    increases with every message of one `servo`, an instance of the service.
    """

    servo: Name
    sequence: SequenceNumber
    goal_id: Name | None = None
    trajectory: SequenceNumber = 1
    scene_revision: SceneRevision | None = None
    until: NonNegative | None = None
    obstruction: Obstruction | None = None


class ServoStart(ShortMessage):
    """Open a session: the robot follows the targets on `servo/target`, as the goal `goal_id` (default: chosen by the servo).

    The robot keeps `margin` (m) from objects of the scene and between its own links; two links that are nearer in nearly all configurations
    keep the distance that they can. Scales are shares of the velocity and
    acceleration limits. While another session is open the answer is `busy`; with `take_over` that one is brought to rest and ended.
    """

    goal_id: Name | None = None
    take_over: bool = False
    margin: Annotated[float, Field(ge=0.005, le=0.2)] = 0.01
    velocity_scale: Scale = 1.0
    acceleration_scale: Scale = 1.0


class ServoEnd(ShortMessage):
    """Bring the robot to rest and end the session `goal_id`, or with an empty request whichever is open. No session is no error."""

    goal_id: Name | None = None


class PoseTarget(Message):
    """Bring the tip to a pose in the base frame: `position` (m), `orientation` `[x, y, z, w]`.

    `linear` (m/s) and `angular` (rad/s) say how the pose moves, in the base frame; both left out: as from the target before to this one.
    Within the `tolerance` the tip is there: what is free is not corrected. With a `group` of the descriptor it is the tip of that group, and
    only its joints move; a robot with several tips needs one.
    """

    kind: Literal["pose"]
    frame: Literal["base"]
    position: Vector3
    orientation: Quaternion
    linear: Vector3 | None = None
    angular: Vector3 | None = None
    tolerance: PoseTolerance | None = None
    group: GroupName | None = None


class TwistTarget(Message):
    """Move the tip with `linear` (m/s) and `angular` (rad/s) velocity, along the axes of the base or of the `tool`, which is the tip.
    `group` as in `PoseTarget`.
    """

    kind: Literal["twist"]
    frame: Literal["base", "tool"]
    linear: Vector3 = (0.0, 0.0, 0.0)
    angular: Vector3 = (0.0, 0.0, 0.0)
    group: GroupName | None = None


class JointSpeedTarget(Message):
    """Move the joints with `velocity` (rad/s)."""

    kind: Literal["joint_speed"]
    velocity: Joints


class JointTarget(Message):
    """Move the joints to `position` (rad), a target that itself moves with `velocity` (rad/s; default: estimated from the last targets)."""

    kind: Literal["joints"]
    position: Joints
    velocity: Joints | None = None


class ServoTarget(ShortMessage):
    """The live target of the session `goal_id`; the newest counts. Publish repeatedly: the robot brakes when the newest is older than 0.1 s.

    `sequence` increases with every target of a session. `stamp` (s) is when the target was made, on any clock
    of the client: it shows the servo how much longer than others a target took to arrive. Refusals are
    in `ServoState.session.refused`.
    """

    goal_id: Name
    sequence: SequenceNumber
    stamp: float
    target: Annotated[PoseTarget | TwistTarget | JointSpeedTarget | JointTarget, Field(discriminator="kind")]


Points = Field(min_length=2, max_length=200)


class JointPoints(Message):
    """Positions of the joints (rad), and their velocities there (rad/s), left out: those of a cubic spline through the positions."""

    kind: Literal["joints"]
    position: Annotated[tuple[Joints, ...], Points]
    velocity: Annotated[tuple[Joints, ...], Points] | None = None


class PosePoints(Message):
    """Poses of the tip in the base frame; with a `group` of the descriptor, of the tip of that group."""

    kind: Literal["poses"]
    pose: Annotated[tuple[Pose, ...], Points]
    group: GroupName | None = None


class ServoChunk(Message):
    """The next piece of motion of the session `goal_id`: 2 to 200 points, `dt` (s) apart or at `time` (s), of which the first is meant for
    `start`.

    `start` (default: `stamp`), `stamp`, when the chunk was made, and `observed`, when what it was made from was seen, are Unix times (s), on a
    clock that agrees with the servo's within 20 ms. `sequence` increases with every chunk of a session. The robot follows the chunk before until
    `start`, then this one; where the two do not meet, it goes over inside the limits of velocity, acceleration and jerk. It brakes when the chunk
    ends, or `expiry` (s) after `start` if that is earlier. `opening` (m) is that of the `gripper` at each point.
    """

    max_bytes: ClassVar[int] = 512 * 1024

    goal_id: Name
    sequence: SequenceNumber
    stamp: float
    start: float | None = None
    observed: float | None = None
    expiry: Positive | None = None
    dt: Annotated[float, Field(gt=0, le=60)] | None = None
    time: Annotated[tuple[NonNegative, ...], Points] | None = None
    points: Annotated[JointPoints | PosePoints, Field(discriminator="kind")]
    gripper: Name | None = None
    opening: Annotated[tuple[NonNegative, ...], Points] | None = None


class Clipped(Message):
    """A chunk asks more of a joint than its limit allows, by `excess`: rad, rad/s, rad/s^2 or rad/s^3. The robot does as much as it can."""

    joint: str
    quantity: Literal["position", "velocity", "acceleration", "jerk"]
    excess: NonNegative


class ChunkAccepted(Message):
    """The chunk will be followed.

    It came `late` (s) after its start, `lost` chunks are missing before it, and it leads `jump` (rad, of the joint that jumps most) away from where
    the robot would have been. `observation_age` (s) is how old what it was made from was. The rest tells how the motion goes so far: `limiting`,
    `link`, `object` and `distance` as in `ServoSession`, and `lag` (s), by which the measured robot is behind the chunks, left out at rest.
    """

    late: NonNegative = 0.0
    lost: Annotated[int, Field(ge=0)] = 0
    jump: NonNegative = 0.0
    clipped: tuple[Clipped, ...] = ()
    observation_age: float | None = None
    limiting: Limiting
    link: str | None = None
    object: str | None = None
    distance: float | None = None
    lag: float | None = None


class ServoSession(Message):
    """The open session: the goal `goal_id` of the executor, and what limits the robot now.

    `slowing` and `blocked` name the `link` and the `object`, of the scene or another link, and their `distance` (m). `clearance` (m) is
    the smallest distance, left out beyond 0.15 m; two links that cannot keep the margin from each other do not count. The errors are those of the measured robot to a target that is a
    pose (m, rad) or joint positions (rad, the worst joint). `sequence` is that of the newest target, which came `target_age` (s)
    ago; `refused` says, for 1 s at least, why a target was not taken. Of its `cycles` the `late_cycles` began more than 2 ms late;
    `computing` (s) is how long 99 of the last 100 took at most. `planned`: it follows a global plan of the planner, because a
    straight way is blocked. `unreachable` says why the planner knows no way to the target; the robot goes as near as it can. While it follows
    chunks, `chunk` is the number of the newest, and `lag` (s) that by which the measured robot is behind them, left out at rest.
    """

    goal_id: Name
    limiting: Limiting = "target_stale"
    link: str | None = None
    object: str | None = None
    distance: float | None = None
    clearance: float | None = None
    moving: bool = False
    position_error: NonNegative | None = None
    orientation_error: NonNegative | None = None
    joint_error: NonNegative | None = None
    sequence: Annotated[int, Field(ge=0)] = 0
    target_age: NonNegative | None = None
    refused: Problem | None = None
    cycles: Annotated[int, Field(ge=0)] = 0
    late_cycles: Annotated[int, Field(ge=0)] = 0
    computing: NonNegative = 0.0
    planned: bool = False
    unreachable: Problem | None = None
    chunk: Annotated[int, Field(ge=0)] = 0
    lag: float | None = None


class ExternalTorque(ShortMessage):
    """How much the efforts that a driver measured at `stamp` (Unix, s) differ from what the motion needs: `torque` (Nm; N if prismatic) from outside,
    a mean over some 20 ms. `largest` is the most (absolute) that each joint has felt since the servo began.

    `joint`, in the motion of the goal `goal_id`, felt more than `execution.external_torque_limits` allow: the executor brakes, and ends the goal.
    """

    stamp: float
    joint_names: JointNames
    torque: Joints
    largest: Joints
    goal_id: Name | None = None
    joint: Name | None = None


class JointDynamics(Message):
    """The dynamics of the joints, identified from measured efforts: Coulomb `friction` (Nm; N if prismatic), `damping` (Nm s/rad; N s/m) and
    `armature`, the inertia of the motors reflected through the gears (kg m²; kg). It comes from `states` joint states of motions, the last five minutes
    at 100 Hz. With it, each joint differed by at most `largest` (Nm; N) from what its motion needed.
    """

    joint_names: JointNames
    friction: Joints
    damping: Joints
    armature: Joints
    largest: Joints
    states: int


CollisionDetectionState = Literal["off", "on", "no_inertia", "no_effort"]
"""Off: no limits are set. On. The URDF does not state the inertia of each link. The driver reports no efforts."""


class ServoState(ShortMessage):
    """What the servo does, and in which scene. `guarding`: it checks the goal `goal_id`, which may go up to `until` (s), if given.

    `following`: that goal follows the targets of the `session`.

    `scene_revision` is the scene that it has, left out before the first. With `scene_lost` the planner is gone or has lost its
    scene; then the last known scene still counts. `problem` says why it gives no authority. `check` is how long the last check took (s).
    `lost_objects` have had no pose for 1 s: each may be anywhere that it can have moved within that time. `pose_refused` says, for
    1 s at least, why the pose of an object was not taken. `collision_detection` says whether efforts are compared with the model, and if not, why.
    """

    activity: Literal["idle", "guarding", "following"]
    goal_id: Name | None = None
    scene_revision: SceneRevision | None = None
    scene_lost: bool = False
    until: NonNegative | None = None
    obstruction: Obstruction | None = None
    problem: Problem | None = None
    check: NonNegative = 0.0
    lost_objects: tuple[Name, ...] = ()
    pose_refused: Problem | None = None
    collision_detection: CollisionDetectionState = "off"
    session: ServoSession | None = None
