"""The robot descriptor, `robots/<name>.yaml`: its keys, and what they must be beside each other."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Literal, NamedTuple, Self

from pydantic import Field, model_validator

from zarm_contract._faults import one_line
from zarm_contract.camera import DescribedCamera
from zarm_contract.collision import CollisionPrimitive, CollisionSphere
from zarm_contract.digital_output import DigitalOutput
from zarm_contract.gripper import Gripper
from zarm_contract.group import JointGroup
from zarm_contract.messages import GroupName, Joints, NonNegative, Positive, SpeedScale
from zarm_contract.section import Section
from zarm_contract.strategies import DRIVER_STRATEGIES, DriverStrategyName
from zarm_contract.tool import Payload, Tool


class CSpace(Section):
    """Joint limits, one value for each of `joints`."""

    velocity: tuple[Positive, ...]
    """Maximum joint velocities (rad/s). How fast the robot moves is set here."""
    acceleration: tuple[Positive, ...]
    """Maximum joint accelerations (rad/s²), also for every stop."""
    jerk: tuple[Positive, ...]
    """Maximum joint jerks (rad/s³)."""


class ToolSpeeds(Section):
    """How the tip moves along lines, arcs and paths.

    Source of the defaults: 0.25 m/s is the limit of ISO 10218-1 for reduced speed.
    """

    speed: Positive = 0.25
    """Speed of the tip (m/s)."""
    acceleration: Positive = 1.0
    """Change of the speed of the tip along its path (m/s²)."""
    rotational_speed: Positive = 1.0
    """Speed at which the tip turns (rad/s)."""


FaultPolicy = Literal["latch", "clear_at_rest"]


class StatedJointDynamics(Section):
    """Friction, damping and armature of the joints, in the order of `joints`, as `zarm identify` finds them. The values of the URDF (`dynamics`) are not read:
    they mostly make simulations stable.
    """

    friction: Annotated[tuple[NonNegative, ...], Field(min_length=1, max_length=64)]
    """Coulomb friction (Nm; N if prismatic)."""
    damping: Annotated[tuple[NonNegative, ...], Field(min_length=1, max_length=64)]
    """Viscous friction (Nm s/rad; N s/m if prismatic)."""
    armature: Annotated[tuple[NonNegative, ...], Field(min_length=1, max_length=64)]
    """Inertia of the motors, reflected through the gears (kg m²; kg if prismatic)."""


class ExecutionSettings(Section):
    """What the executor checks before and during motion.

    Sources of the defaults: MoveIt for the allowed duration, ros2_control for the path and goal tolerances, the settle time
    and the stopped velocity. The duration is allowed at 0.05 of the planned speed, so that the executor waits for a driver
    with a speed slider of its own (UR) while it makes progress.
    """

    control_rate: Annotated[float, Field(ge=100, le=500)] = 100.0
    """Rate of the control loop (Hz)."""
    speed_scale: SpeedScale = 1.0
    """Share of the planned speed at which the robot moves until a client changes it."""

    start_tolerance: Positive = 0.05
    """How far each joint may be from the start of the trajectory (rad)."""
    path_tolerance: Positive = 0.2
    """How far each joint may leave the trajectory in motion (rad)."""
    goal_tolerance: Positive = 0.01
    """How close each joint must be to the goal at the end (rad)."""
    settle_time: Positive = 1.0
    """How long the robot may take to come to rest at the end (s)."""
    joint_state_timeout: Positive = 0.1
    """Maximum age of the measured joint state (s): older joints hold a motion, and none starts."""
    hold_timeout: NonNegative = 1.0
    """How long a motion is held for new joint states before it is a fault (s); 0: at once."""
    stopped_velocity: Positive = 0.01
    """A robot below this joint velocity is at rest (rad/s)."""
    allowed_duration_factor: Annotated[float, Field(ge=1)] = 1.1
    """A motion may take this many times its planned duration ..."""
    allowed_duration_margin: NonNegative = 0.5
    """... and this much more (s)."""
    progress_timeout: Positive = 1.0
    """How long the driver of a moving robot may stay at one point of its path (s)."""
    paused_timeout: NonNegative = 300.0
    """How long a motion waits while the robot is paused by its own controls, as its pendant or a protective stop (s); then it ends in a fault.
    Known from a driver that reports its speed."""
    faults: FaultPolicy = "latch"
    """How a fault is left. `latch`: by `reset` alone. `clear_at_rest`: also by the next goal, once the robot rests and reports its joints. A robot that did not stop when it was told to needs a `reset` either way."""

    joint_dynamics: StatedJointDynamics | None = None
    """The friction of the joints and the inertia of their motors, which count as what a motion needs: plans keep the efforts with them, and inverse
    dynamics includes them. Left out: they count as torque from outside, and `external_torque_limits` have to be wider than they are."""
    external_torque_limits: Annotated[tuple[Positive, ...], Field(min_length=1, max_length=64)] | None = None
    """How much the measured effort of each joint may differ from what its motion needs (Nm; N if prismatic): beyond that something pushes the robot,
    and the motion ends in a fault. The servo compares them; it needs the inertia of each link in the URDF, and a driver that reports
    efforts. Left out: collisions are not detected."""

    guard: Literal["optional", "required"] = "optional"
    """Whether a servo must guard every motion. `required`: without one none starts, and one that runs is held. `optional`: it moves
    unguarded."""
    guard_timeout: Annotated[float, Field(ge=0.2)] = 0.5
    """How long the servo may be silent before it is taken to be gone (s)."""
    obstruction_timeout: NonNegative = 30.0
    """How long a goal that is held waits before it is given up (s)."""

    @property
    def control_period(self) -> float:
        """Time between two ticks of the control loop, s."""
        return 1.0 / self.control_rate


def _is_multiple(span: float, step: float) -> bool:
    return round(span / step) >= 1 and abs(span / step - round(span / step)) < 1e-6


class StrategyParams(Section):
    """How to speak to the driver of the robot. The defaults of `point_dt` and `chunk_period` are those of the Doosan driver."""

    command_topic: str = Field(min_length=1)
    """ROS topic on which the driver takes trajectories. On Zenoh it is `driver/command`."""
    state_topic: Annotated[str, Field(min_length=1)] | None = None
    """ROS topic on which the driver reports its progress, 0 to 1. Left out: the executor computes the progress from the joint states."""
    speed_scaling_topic: Annotated[str, Field(min_length=1)] | None = None
    """ROS topic of the speed that the robot's own controls allow, in percent: a UR's `/speed_scaling_state_broadcaster/speed_scaling`. While that
    is 0, the motion is paused (`execution.paused_timeout`)."""
    joint_states_topic: str = Field(min_length=1)
    """ROS topic of the joint states."""
    action: Annotated[str, Field(min_length=1)] | None = None
    """ROS action of a trajectory controller, `.../follow_joint_trajectory`. Whole trajectories go there, and what it refuses or gives up ends the
    goal with its reason. Left out: they go to `command_topic`, where nothing is reported."""
    strategies: tuple[DriverStrategyName, ...] = Field(default=tuple(DRIVER_STRATEGIES), min_length=1)
    """What the driver can play: streamed velocities, streamed positions, whole trajectories."""
    joint_order: tuple[str, ...] | None = None
    """Order of the columns in commands. Default: `joints`. Joint states are read by name."""
    joint_states_order: tuple[str, ...] | None = None
    """Order of joint states without names. Default: `joints`."""
    point_dt: Annotated[float, Field(ge=0.001, le=0.1)] = 0.02
    """Time between two points of a command (s)."""
    chunk_period: Positive = 0.08
    """How often the streaming strategies send (s): a multiple of `point_dt` and, for these strategies, of the period of the control loop."""
    look_ahead: Positive = 0.08
    """How far each chunk continues beyond the next one, before it brakes to rest (s): a multiple of `point_dt`."""
    delay: Annotated[float, Field(ge=0, le=1)] = 0.06
    """Measured time from a command to the motion (s)."""
    gain: NonNegative = 2.0
    """Share of the position error that `joint_speed` corrects per second (1/s)."""
    velocity: tuple[Positive, ...] | None = None
    """Maximum of streamed velocities (rad/s). Default: `cspace.velocity`."""
    acceleration: tuple[Positive, ...] | None = None
    """Maximum change of streamed velocities (rad/s²). Default: `cspace.acceleration`."""
    stop: Literal["path", "empty"] = "path"
    """`path`: brake along the path. `empty`: send an empty trajectory, so that the driver brakes by itself."""

    @property
    def timing(self) -> CommandTiming:
        """When commands reach the robot."""
        return CommandTiming(self.point_dt, self.chunk_period, self.look_ahead, self.delay)

    def faults(self, joints: tuple[str, ...]) -> Iterator[str]:
        """What is wrong beside these joints, as `key: message`."""
        for name, order in (("joint_order", self.joint_order), ("joint_states_order", self.joint_states_order)):
            if order is not None and sorted(order) != sorted(joints):
                yield f"{name}: name each of {', '.join(joints)} once, in the order of the driver"
        for name, bounds in (("velocity", self.velocity), ("acceleration", self.acceleration)):
            if bounds is not None and len(bounds) != len(joints):
                yield f"{name}: {len(bounds)} values for {len(joints)} joints"
        for name, span in (("chunk_period", self.chunk_period), ("look_ahead", self.look_ahead)):
            if not _is_multiple(span, self.point_dt):
                yield f"{name}: {span:g} s is not a whole number of points; use a multiple of point_dt {self.point_dt:g} s"
        if self.gain * (self.delay + self.chunk_period) > 1.0:
            yield (
                f"gain: the robot would oscillate, because {self.gain:g}/s times delay and chunk_period is more than 1; use "
                f"at most {1.0 / (self.delay + self.chunk_period):.3g}"
            )


class MemberRobot(Section):
    """A robot that has an executor of its own, as part of a robot that leads it."""

    robot: Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]{0,63}$")]
    """Its name on the bus."""
    delay: Annotated[float, Field(ge=0, le=1)] = 0.0
    """Measured time from a command of its executor to the motion (s): the `delay` of its own `strategy_params`."""


class CommandTiming(NamedTuple):
    """When commands reach a robot, in s: the time between two points, how often they are sent, how far they go on beyond the next ones, and how
    far the robot is behind the command.
    """

    point_dt: float
    chunk_period: float
    look_ahead: float
    delay: float


_TO_EXECUTORS = CommandTiming(point_dt=0.005, chunk_period=0.08, look_ahead=0.24, delay=0.06)
"""Commands to other executors. They begin 0.05 s after they are sent, so that all have them by then, and with the next tick. At points every
0.02 s, what lies between them would need up to 16 % more acceleration; one that is 0.2 s late does no harm.
"""


class RobotDescriptor(Section):
    """One robot: a YAML file with its URDF beside it. Lengths in m, angles in rad, times in s."""

    name: Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]{0,63}$")]
    """Lower-case letters, digits and `_`; part of every key on the bus. Use the name of the file."""
    urdf: str
    """The URDF file, relative to the descriptor."""
    base_link: str
    """The link that does not move. Poses are given in its frame."""
    tip_link: str
    """The link whose pose a goal gives: the flange, or the tool centre point. With `groups`, the tip of one of them."""
    joints: tuple[str, ...] = Field(min_length=1, max_length=32)
    """The moving joints from `base_link` to `tip_link`, in this order; with `groups`, those of all groups, each after the joint that
    carries it. Every joint vector follows it."""
    home: Joints
    """A pose to start from (rad): elbow bent, far from joint limits and singularities, free of self-collision."""
    cspace: CSpace
    """Joint limits."""
    spheres: dict[str, tuple[CollisionSphere, ...]]
    """For each link, spheres that contain its exact geometry. The search uses them."""
    collision: dict[str, tuple[CollisionPrimitive, ...]]
    """For each link, its exact geometry. Every trajectory is verified against it."""
    self_collision_ignore: tuple[tuple[str, str], ...]
    """Pairs of links that are never checked against each other."""
    self_collision_exact: tuple[tuple[str, str], ...] = ()
    """Pairs that pass each other too closely for their spheres: the search leaves them to the exact check of its result."""
    self_margin: Annotated[float, Field(ge=0, le=0.2)] = 0.005
    """Distance that a plan keeps between links (m), unless its request says another."""
    grippers: dict[Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]{0,63}$")], Gripper] = Field(default={}, max_length=8)
    """The robot's grippers by name."""
    outputs: dict[Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]{0,63}$")], DigitalOutput] = Field(
        default={}, max_length=64
    )
    """Its digital outputs by name."""
    cameras: dict[Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]{0,63}$")], DescribedCamera] = Field(
        default={}, max_length=16
    )
    """Depth cameras by name, from which the voxel map is made."""
    stale_map: Literal["refuse", "slow", "ignore"] = "refuse"
    """What becomes of plans while a camera does not see, or the perception has gone: `refuse` them, make them `slow`, at a tenth of velocity and acceleration, or
    `ignore` it; the last two use what was seen."""
    groups: dict[GroupName, JointGroup] = Field(default={}, max_length=16)
    """Joint groups by name, for a robot with several arms, or an arm on a torso or an axis: what a request may plan for. A request that names no
    group is for all joints. Left out: the robot is one arm."""
    payloads: dict[str, Payload] = Field(default={}, max_length=16)
    """What is mounted on links, by link. Plans keep the efforts of the joints with it, and a simulation with physics weighs it."""
    tools: dict[Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]{0,47}$")], Tool] = Field(default={}, max_length=32)
    """Tools by name, which can be mounted and changed at run time: `zarm tool mount`. At the start none is."""
    tool: ToolSpeeds = ToolSpeeds()
    """How the tip moves along lines, arcs and paths, unless the request says otherwise."""
    interpolation_dt: Annotated[float, Field(ge=0.001, le=0.1)] = 0.02
    """Maximum time between two samples of a planned trajectory (s)."""
    execution: ExecutionSettings = ExecutionSettings()
    """What the executor checks before and during motion."""
    executors: dict[GroupName, MemberRobot] = Field(default={}, max_length=8)
    """For a robot of several robots that have an executor of their own each: by group, that robot. Its joints and grippers are those of the
    group, without `<group>_` in front. The strategy `executors` moves them in step."""
    strategy: str = "emulator"
    """The control strategy at the start. `emulator` moves no hardware."""
    strategy_params: StrategyParams | None = None
    """How to speak to the driver of the robot. Left out: there is no driver, only the emulator."""

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        count = len(self.joints)
        vectors: dict[str, tuple[float, ...]] = {
            "home": self.home,
            "cspace.velocity": self.cspace.velocity,
            "cspace.acceleration": self.cspace.acceleration,
            "cspace.jerk": self.cspace.jerk,
        }
        if self.execution.external_torque_limits is not None:
            vectors["execution.external_torque_limits"] = self.execution.external_torque_limits
        if (stated := self.execution.joint_dynamics) is not None:
            vectors |= {f"execution.joint_dynamics.{term}": getattr(stated, term) for term in type(stated).model_fields}
        faults = ["joints: a name appears twice"] if len(set(self.joints)) != count else []
        faults += [
            f"{name}: {len(vector)} values for {count} joints"
            for name, vector in vectors.items()
            if len(vector) != count
        ]
        faults += [
            f"spheres: the link {link} has collision geometry but no sphere that covers it"
            for link in self.collision
            if not self.spheres.get(link)
        ]
        faults += [
            f"collision: the link {link} has spheres but no exact geometry"
            for link in self.spheres
            if not self.collision.get(link)
        ]
        if not self.collision and not self.spheres:
            faults.append(
                "collision: no link has geometry, so that nothing would keep the robot from colliding; give the links "
                "primitives here and the spheres that cover them in `spheres`"
            )
        faults += [
            f"grippers.{name}.{key}: {fault}"
            for name, gripper in self.grippers.items()
            for key, fault in gripper.faults()
        ]
        driven = [gripper.joint for gripper in self.grippers.values()]
        faults += [
            f"grippers.{name}.joint: {gripper.joint} is the joint of two grippers; each needs its own"
            for name, gripper in self.grippers.items()
            if driven.count(gripper.joint) > 1
        ]
        faults += [
            f"groups.{name}.{key}: {fault}"
            for name, group in self.groups.items()
            for key, fault in group.faults(self.groups)
        ]
        faults += self._executor_faults()
        if self.strategy_params is not None:
            faults += [f"strategy_params.{fault}" for fault in self.strategy_params.faults(self.joints)]
            period, chunk = self.execution.control_period, self.strategy_params.chunk_period
            streamed = any(DRIVER_STRATEGIES[name] == "chunks" for name in self.strategy_params.strategies)
            if streamed and not _is_multiple(chunk, period):
                faults.append(
                    f"strategy_params.chunk_period: {chunk:g} s is not a whole number of periods of the control loop, so that "
                    f"chunks would not be evenly spaced; use a multiple of {period:g} s, or change execution.control_rate"
                )
        if faults:
            raise ValueError("\n".join(map(one_line, faults)))
        return self

    @property
    def command_timing(self) -> CommandTiming | None:
        """When commands reach the robot through its driver, or through other executors; None if there are only emulated ones."""
        if self.executors:
            return _TO_EXECUTORS._replace(
                delay=_TO_EXECUTORS.delay + max(member.delay for member in self.executors.values())
            )
        return None if self.strategy_params is None else self.strategy_params.timing

    def _executor_faults(self) -> Iterator[str]:
        for group in self.executors:
            if group not in self.groups:
                yield f"executors.{group}: there is no such group; the groups are {', '.join(self.groups) or 'none'}"
        if len({member.robot for member in self.executors.values()}) < len(self.executors):
            yield "executors: a robot is named twice; each group has an executor of its own"
        for joint in self.joints if self.executors else ():
            owners = [group for group in self.executors if joint.startswith(f"{group}_")]
            if len(owners) != 1:
                yield (
                    f"executors: {joint} must begin with the name of one of the groups {', '.join(self.executors)} and _, so that it is known "
                    "whose it is"
                )
