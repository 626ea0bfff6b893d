"""The robot descriptor, `robots/<name>.yaml`: one model, and errors that name the file and the line."""

from __future__ import annotations

import difflib
import hashlib
import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import Field, ValidationError, model_validator

from zarm_contract._faults import field_path, one_line, sentence
from zarm_contract.document import Document, KeyPath, read_document
from zarm_contract.errors import InvalidRequest
from zarm_contract.gripper import Gripper
from zarm_contract.group import JointGroup
from zarm_contract.messages import GroupName, Joints, NonNegative, Positive, Quaternion, SpeedScale, Vector3
from zarm_contract.section import Section
from zarm_contract.strategies import DRIVER_STRATEGIES, DriverStrategyName
from zarm_contract.urdf import Urdf, load_urdf

ROBOTS = Path(__file__).parent / "robots"
"""The descriptors that come with zarm."""


class CollisionSphere(Section):
    """A ball of `radius` m around `center` in its link's frame."""

    kind: Literal["sphere"] = "sphere"
    """May be left out for a sphere."""
    center: Vector3
    """Centre in the frame of the link (m)."""
    radius: Positive
    """Radius (m)."""


class CollisionCapsule(Section):
    """All points within `radius` m of the segment `a`-`b` in the link's frame."""

    kind: Literal["capsule"]
    a: Vector3
    """One end of the segment, in the frame of the link (m)."""
    b: Vector3
    """The other end (m)."""
    radius: Positive
    """The capsule is every point within this distance of the segment (m)."""


class CollisionCylinder(Section):
    """A flat-ended cylinder; `a` and `b` are the centres of its end faces in the link's frame."""

    kind: Literal["cylinder"]
    a: Vector3
    """Centre of one end face, in the frame of the link (m)."""
    b: Vector3
    """Centre of the other (m)."""
    radius: Positive
    """Radius (m)."""


class CollisionCuboid(Section):
    """A box of full edge lengths `size` m, centred at `center` and turned by `orientation` in the link's frame."""

    kind: Literal["cuboid"]
    center: Vector3
    """Centre in the frame of the link (m)."""
    orientation: Quaternion = (0.0, 0.0, 0.0, 1.0)
    """Rotation in the frame of the link, `[x, y, z, w]`."""
    size: tuple[Positive, Positive, Positive]
    """Full edge lengths along its own x, y, z (m)."""


CollisionPrimitive = Annotated[
    CollisionSphere | CollisionCapsule | CollisionCylinder | CollisionCuboid, Field(discriminator="kind")
]


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
    groups: dict[GroupName, JointGroup] = Field(default={}, max_length=16)
    """Joint groups by name, for a robot with several arms, or an arm on a torso or an axis: what a request may plan for. A request that names no
    group is for all joints. Left out: the robot is one arm."""
    tool: ToolSpeeds = ToolSpeeds()
    """How the tip moves along lines, arcs and paths, unless the request says otherwise."""
    interpolation_dt: Annotated[float, Field(ge=0.001, le=0.1)] = 0.02
    """Maximum time between two samples of a planned trajectory (s)."""
    execution: ExecutionSettings = ExecutionSettings()
    """What the executor checks before and during motion."""
    strategy: str = "emulator"
    """The control strategy at the start. `emulator` moves no hardware."""
    strategy_params: StrategyParams | None = None
    """How to speak to the driver of the robot. Left out: there is no driver, only the emulator."""

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        count = len(self.joints)
        vectors: Mapping[str, tuple[float, ...]] = {
            "home": self.home,
            "cspace.velocity": self.cspace.velocity,
            "cspace.acceleration": self.cspace.acceleration,
            "cspace.jerk": self.cspace.jerk,
        }
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


_HALF_TURN = math.pi + 1e-6
"""Half a turn (rad), and a little more, so that no rounding makes two halves less than a turn."""


@dataclass(frozen=True)
class RobotDescription:
    """A descriptor together with its URDF's kinematics.

    `path` is the descriptor's file. `lower` and `upper` are the position limits of `descriptor.joints` (rad), from
    the URDF; those of a continuous joint, which turns freely, are infinite. `hash` names this exact content: two services that show different hashes
    know different robots. `whole` is given for a `group` of a robot.
    """

    descriptor: RobotDescriptor
    path: Path
    urdf: Urdf
    urdf_path: Path
    lower: tuple[float, ...]
    upper: tuple[float, ...]
    hash: str
    whole: RobotDescription | None = None

    @property
    def tips(self) -> tuple[str, ...]:
        """The tips of all groups; without groups, the `tip_link`."""
        tips = (group.tip_link for group in self.descriptor.groups.values() if group.tip_link is not None)
        return tuple(dict.fromkeys(tips)) or (self.descriptor.tip_link,)

    def group_joints(self, name: str, field: str = "group") -> tuple[str, ...]:
        """The joints of a group, in the order of the robot's. Raises InvalidRequest that names the `field`."""
        known, base_link = self.descriptor.groups, self.descriptor.base_link
        if name not in known:
            names = f"its groups are {', '.join(known)}" if known else "it is one arm: leave the group out"
            raise InvalidRequest(f"{self.descriptor.name} has no group {name}; {names}", field=field)
        parts = known[name].groups or (name,)
        moving = {joint for part in parts for joint in known[part].moving(self.urdf, base_link)}
        return tuple(joint for joint in self.descriptor.joints if joint in moving)

    def group_with(self, joints: Collection[str]) -> str | None:
        """The smallest group that has these joints; None if there is none, and for a robot without groups."""
        known = {name: self.group_joints(name) for name in self.descriptor.groups}
        fitting = [name for name, own in known.items() if set(joints) <= set(own)]
        return min(fitting, key=lambda name: len(known[name]), default=None)

    def tip_of(self, groups: Sequence[str]) -> str:
        """The tip of the first of these groups; without any, the `tip_link`."""
        if not groups:
            return self.descriptor.tip_link
        first = self.descriptor.groups[groups[0]]
        return first.tip_link or self.tip_of(first.groups)

    def check_tip(self, group: str | None, field: str = "group") -> None:
        """Raises InvalidRequest that names the `field` unless a group has one tip; without one, unless all joints move the only tip."""
        groups = self.descriptor.groups
        if group is None:
            named = [name for name, one in groups.items() if one.tip_link is not None]
            if groups and not any(self.group_joints(name) == self.descriptor.joints for name in named):
                message = f"the robot has several tips; name one of the groups {', '.join(named)}"
                raise InvalidRequest(message, field=field)
            return
        self.group_joints(group, field)
        if parts := groups[group].groups:
            raise InvalidRequest(f"{group} has several tips; name one of its groups, {', '.join(parts)}", field=field)

    def group(self, *names: str) -> RobotDescription:
        """This robot with the joints of these groups alone, and the tip of the first; `whole` is the robot. Raises
        InvalidRequest for unknown groups.
        """
        moving = {joint for name in names for joint in self.group_joints(name)}
        at = [index for index, joint in enumerate(self.descriptor.joints) if joint in moving]
        limits = self.descriptor.cspace
        cspace = CSpace.model_construct(
            velocity=tuple(limits.velocity[k] for k in at),
            acceleration=tuple(limits.acceleration[k] for k in at),
            jerk=tuple(limits.jerk[k] for k in at),
        )
        update = {
            "joints": tuple(self.descriptor.joints[k] for k in at),
            "tip_link": self.tip_of(names),
            "home": tuple(self.descriptor.home[k] for k in at),
            "cspace": cspace,
        }
        return replace(
            self,
            descriptor=self.descriptor.model_copy(update=update),
            lower=tuple(self.lower[k] for k in at),
            upper=tuple(self.upper[k] for k in at),
            whole=self,
        )

    @property
    def continuous(self) -> tuple[bool, ...]:
        """Which joints turn freely: for them, angles that differ by whole turns are the same."""
        return tuple(map(math.isinf, self.upper))

    def gripper_positions(self, widths: Mapping[str, float]) -> dict[str, float]:
        """The position (rad, m) of each joint of the grippers at these openings (m) by gripper; one that is left out is open."""
        return {
            joint: multiplier * position + offset
            for name, gripper in self.descriptor.grippers.items()
            for position in [gripper.position(widths.get(name, gripper.open))]
            for joint, (multiplier, offset) in gripper.joints(self.urdf).items()
        }

    def range_about(self, position: Sequence[float]) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Finite limits, lower and upper, to sample or to show: those of the joints, or for a continuous one half a turn
        to each side of its `position` (rad).
        """
        lower = (at - _HALF_TURN if low == -math.inf else low for low, at in zip(self.lower, position, strict=True))
        upper = (at + _HALF_TURN if high == math.inf else high for high, at in zip(self.upper, position, strict=True))
        return tuple(lower), tuple(upper)


def find_robot(name_or_path: str) -> Path:
    """The descriptor's file for a robot that comes with zarm, or for a path. Raises InvalidRequest."""
    if name_or_path.endswith((".yaml", ".yml")) or "/" in name_or_path:
        path = Path(name_or_path)
        if not path.is_file():
            raise InvalidRequest(f"there is no robot descriptor at {path}")
        return path.resolve()
    path = ROBOTS / f"{name_or_path}.yaml"
    if not path.is_file():
        known = ", ".join(sorted(file.stem for file in ROBOTS.glob("*.yaml")))
        raise InvalidRequest(f"unknown robot {name_or_path!r}: zarm brings {known}; or give the path of a .yaml file")
    return path.resolve()


def load_robot(name_or_path: str) -> RobotDescription:
    """Read and check a descriptor and its URDF. Raises InvalidRequest with file, line and remedy; one line per fault."""
    document = read_document(find_robot(name_or_path), "a robot descriptor")
    try:
        descriptor = RobotDescriptor.model_validate(document.data)
    except ValidationError as error:
        raise InvalidRequest(
            "\n".join(_explain(document, fault["loc"], fault["msg"], fault["type"]) for fault in error.errors())
        ) from error
    urdf_path = document.path.parent / descriptor.urdf
    if not urdf_path.is_file():
        message = f"cannot read the URDF {urdf_path}: no such file; the path is relative to the descriptor's folder"
        raise InvalidRequest(document.fault(("urdf",), message))
    urdf = load_urdf(urdf_path, {gripper.joint for gripper in descriptor.grippers.values()})
    faults = _against_urdf(descriptor, urdf)
    if faults:
        raise InvalidRequest("\n".join(document.fault(key, message) for key, message in faults))
    limits = {joint.name: (joint.lower, joint.upper) for joint in urdf.joint_of_child.values()}
    return RobotDescription(
        descriptor=descriptor,
        path=document.path,
        urdf=urdf,
        urdf_path=urdf_path,
        lower=tuple(-math.inf if (low := limits[name][0]) is None else low for name in descriptor.joints),
        upper=tuple(math.inf if (high := limits[name][1]) is None else high for name in descriptor.joints),
        hash=hashlib.sha256(document.text.encode() + urdf_path.read_bytes()).hexdigest()[:16],
    )


def _against_urdf(robot: RobotDescriptor, urdf: Urdf) -> list[tuple[KeyPath, str]]:
    """Faults of the descriptor that only show beside its URDF, with the path of the key to blame."""
    named: dict[KeyPath, str] = {("base_link",): robot.base_link, ("tip_link",): robot.tip_link}
    named |= {("spheres", link): link for link in robot.spheres}
    named |= {("collision", link): link for link in robot.collision}
    named |= {
        (key, index, side): link
        for key in ("self_collision_ignore", "self_collision_exact")
        for index, pair in enumerate(getattr(robot, key))
        for side, link in enumerate(pair)
    }
    faults: list[tuple[KeyPath, str]] = [
        (key, f"the link {link} is not in {robot.urdf}; the links there are {', '.join(urdf.links)}")
        for key, link in named.items()
        if link not in urdf.links
    ]
    if faults:
        return faults
    if faults := [*_group_faults(robot, urdf)] if robot.groups else [*_chain_faults(robot, urdf)]:
        return faults
    joints = {joint.name: joint for joint in urdf.joint_of_child.values()}
    for index, (name, value) in enumerate(zip(robot.joints, robot.home, strict=True)):
        joint = joints[name]
        if joint.lower is not None and joint.upper is not None and not joint.lower <= value <= joint.upper:
            limits = f"{joint.lower} to {joint.upper}"
            faults.append((("home", index), f"{value} is outside the limits of {joint.name}: {limits}"))
    faults += [
        (("grippers", name, key), fault)
        for name, gripper in robot.grippers.items()
        for key, fault in gripper.faults_in(urdf, robot.joints)
    ]
    return faults + [(("collision", link), fault) for link in robot.collision for fault in _mount(robot, urdf, link)]


def _chain_faults(robot: RobotDescriptor, urdf: Urdf) -> Iterator[tuple[KeyPath, str]]:
    """What is wrong with the joints of one arm."""
    try:
        chain = urdf.chain(robot.base_link, robot.tip_link)
    except InvalidRequest as error:
        yield ("tip_link",), error.problem.message
        return
    names = tuple(joint.name for joint in chain if joint.type != "fixed")
    if names != robot.joints:
        yield ("joints",), f"the moving joints from base_link to tip_link are {[*names]}; list them in this order"


def _group_faults(robot: RobotDescriptor, urdf: Urdf) -> Iterator[tuple[KeyPath, str]]:
    """What is wrong with the joints of a robot with groups."""
    moving = {joint.name: joint for joint in urdf.joint_of_child.values() if joint.type != "fixed"}
    for index, name in enumerate(robot.joints):
        if name not in moving:
            yield ("joints", index), f"{name} is not a moving joint of the URDF; those are {', '.join(moving)}"
            continue
        try:
            carriers = urdf.chain(robot.base_link, moving[name].parent)
        except InvalidRequest as error:
            yield ("joints", index), error.problem.message
            continue
        for carrier in carriers:
            if carrier.name in robot.joints[index:]:
                yield ("joints", index), f"{carrier.name} carries {name}; list it before"
        if not any(name in group.moving(urdf, robot.base_link) for group in robot.groups.values()):
            yield ("joints", index), f"no group moves {name}; add it to one in `groups`"
    tips = [group.tip_link for group in robot.groups.values() if group.tip_link is not None]
    if robot.tip_link not in tips:
        yield ("tip_link",), f"{robot.tip_link} is the tip of no group; those are {', '.join(tips)}"
    for name, group in robot.groups.items():
        for key, fault in group.faults_in(urdf, robot.base_link, robot.joints):
            yield ("groups", name, key), fault


def _mount(robot: RobotDescriptor, urdf: Urdf, link: str) -> Iterator[str]:
    """What keeps the robot's joints from telling where a link is."""
    try:
        chain = urdf.chain(robot.base_link, link)
    except InvalidRequest as error:
        yield error.problem.message
        return
    gripping = {name for gripper in robot.grippers.values() for name in gripper.joints(urdf)}
    for joint in chain:
        if joint.type != "fixed" and joint.name not in robot.joints and joint.name not in gripping:
            yield (
                f"it hangs on {joint.name}, which is not a joint of the robot; describe its gripper in `grippers`, or give that joint "
                'type="fixed" in the URDF'
            )


def _explain(document: Document, loc: KeyPath, message: str, kind: str) -> str:
    """One line per fault that pydantic found, with what to do where its message does not say so."""
    if not loc:  # the rules over the whole file name their keys themselves: `cspace.jerk: 5 values for 6 joints`
        named = [line.split(": ", 1) for line in sentence(message).splitlines()]
        return "\n".join(document.fault(tuple(key.split(".")), fault) for key, fault in named)
    key = field_path(loc, document.data)
    return document.fault(key, sentence(message) + _remedy(kind, str(key[-1])))


def _remedy(kind: str, key: str) -> str:
    match kind:
        case "missing":
            return "; docs/reference/robot.md explains what to write here"
        case "extra_forbidden":
            known = {name for section in Section.__subclasses__() for name in section.model_fields}
            close = difflib.get_close_matches(key, known, 1)
            return f"; did you mean {close[0]}?" if close else "; docs/reference/robot.md lists the keys"
        case "union_tag_not_found":
            return "; write kind: sphere, capsule, cylinder or cuboid"
        case "tuple_type":
            return "; write a list: [0.1, 0.2, 0.3]"
        case "string_pattern_mismatch":
            return "; use small letters, digits and _, a letter first"
        case _:
            return ""
