"""The robot descriptor, `robots/<name>.yaml`: one model, and errors that name the file and the line."""

from __future__ import annotations

import difflib
import hashlib
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from zarm_contract._document import Document, KeyPath, read_document
from zarm_contract._faults import field_path, one_line, sentence
from zarm_contract.errors import InvalidRequest
from zarm_contract.messages import Joints, NonNegative, Positive, Quaternion, SpeedScale, Vector3
from zarm_contract.strategies import DRIVER_STRATEGIES, DriverStrategyName
from zarm_contract.urdf import Urdf, load_urdf

ROBOTS = Path(__file__).parent / "robots"
"""The descriptors that come with zarm."""


class _Section(BaseModel):
    # Not strict: a descriptor is written by hand, and to YAML `1` is no float, `1e-3` a text and `[...]` no tuple.
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class CollisionSphere(_Section):
    """A ball of `radius` m around `center` in its link's frame."""

    kind: Literal["sphere"] = "sphere"
    center: Vector3
    radius: Positive


class CollisionCapsule(_Section):
    """All points within `radius` m of the segment `a`-`b` in the link's frame."""

    kind: Literal["capsule"]
    a: Vector3
    b: Vector3
    radius: Positive


class CollisionCylinder(_Section):
    """A flat-ended cylinder; `a` and `b` are the centres of its end faces in the link's frame."""

    kind: Literal["cylinder"]
    a: Vector3
    b: Vector3
    radius: Positive


class CollisionCuboid(_Section):
    """A box of full edge lengths `size` m, centred at `center` and turned by `orientation` in the link's frame."""

    kind: Literal["cuboid"]
    center: Vector3
    orientation: Quaternion = (0.0, 0.0, 0.0, 1.0)
    size: tuple[Positive, Positive, Positive]


CollisionPrimitive = Annotated[
    CollisionSphere | CollisionCapsule | CollisionCylinder | CollisionCuboid, Field(discriminator="kind")
]


class CSpace(_Section):
    """Limits per joint, in descriptor order: rad/s, rad/s^2, rad/s^3. The speed of the robot is set here."""

    velocity: tuple[Positive, ...]
    acceleration: tuple[Positive, ...]
    jerk: tuple[Positive, ...]


class Execution(_Section):
    """What the executor demands before and during motion. Angles in rad, times in s.

    Defaults: start 0.05 (MoveIt 0.01), path 0.2 and goal 0.01 (ros2_control), settle 1.0 (ros2_control),
    allowed duration 1.1 x + 0.5 s (MoveIt), stopped below 0.01 rad/s (ros2_control). The allowed duration is that of a
    driver at 0.05 of the speed it was told, so that one with a speed slider of its own (UR) is waited for while it makes
    progress. `progress_timeout` is how long a moving robot's driver may stay at one point of the path. Joints older than
    `joint_state_timeout` hold a motion, for `hold_timeout` more at most: then it is a fault (1.0, longer than a busy machine keeps
    a driver waiting). `control_rate` is that of the control loop in Hz, `speed_scale` the share of the planned speed at which the
    robot moves until a client changes it.
    """

    control_rate: Annotated[float, Field(ge=100, le=500)] = 100.0
    speed_scale: SpeedScale = 1.0

    start_tolerance: Positive = 0.05
    path_tolerance: Positive = 0.2
    goal_tolerance: Positive = 0.01
    settle_time: Positive = 1.0
    joint_state_timeout: Positive = 0.1
    hold_timeout: NonNegative = 1.0
    stopped_velocity: Positive = 0.01
    allowed_duration_factor: Annotated[float, Field(ge=1)] = 1.1
    allowed_duration_margin: NonNegative = 0.5
    progress_timeout: Positive = 1.0

    @property
    def control_period(self) -> float:
        """Time between two ticks of the control loop, s."""
        return 1.0 / self.control_rate


def _is_multiple(span: float, step: float) -> bool:
    return round(span / step) >= 1 and abs(span / step - round(span / step)) < 1e-6


class StrategyParams(_Section):
    """How the robot's driver is spoken to. Times in s, angles in rad.

    `strategies` are those of the executor that this driver can play, all of them where it is left out. The topics are those of
    the ROS side; without `state_topic` the driver tells no progress. A command has one point
    every `point_dt`, its columns in `joint_order`; `joint_states_order` is that of joint states without names. The streaming strategies send one every `chunk_period`, which reaches
    `look_ahead` further than the next; the robot follows `delay` later. `velocity` and `acceleration` bound what is
    streamed. Defaults: `cspace` for the bounds and `joints` for the order; 0.02 and 0.08 from the Doosan bridge.
    """

    command_topic: str = Field(min_length=1)
    state_topic: Annotated[str, Field(min_length=1)] | None = None
    joint_states_topic: str = Field(min_length=1)
    strategies: tuple[DriverStrategyName, ...] = Field(default=tuple(DRIVER_STRATEGIES), min_length=1)
    joint_order: tuple[str, ...] | None = None
    joint_states_order: tuple[str, ...] | None = None
    point_dt: Annotated[float, Field(ge=0.001, le=0.1)] = 0.02
    chunk_period: Positive = 0.08
    look_ahead: Positive = 0.08
    delay: Annotated[float, Field(ge=0, le=1)] = 0.06
    gain: NonNegative = 2.0
    velocity: tuple[Positive, ...] | None = None
    acceleration: tuple[Positive, ...] | None = None
    stop: Literal["path", "empty"] = "path"

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
                yield f"{name}: {span:g} s is no whole number of points; use a multiple of point_dt {self.point_dt:g} s"
        if self.gain * (self.delay + self.chunk_period) > 1.0:
            yield (
                f"gain: the robot would swing, because {self.gain:g}/s times delay and chunk_period is more than 1; use "
                f"at most {1.0 / (self.delay + self.chunk_period):.3g}"
            )


class RobotDescriptor(_Section):
    """A robot as every service needs it. `urdf` is a path relative to the descriptor's file.

    `joints` are the moving joints from `base_link` to `tip_link` in kinematic order; every joint vector of zarm follows
    it. `spheres` cover `collision` link by link: the first serve fast checks, the second are the exact geometry.
    `interpolation_dt` (s) is the longest time between samples of planned trajectories.
    """

    name: Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]{0,63}$")]
    urdf: str
    base_link: str
    tip_link: str
    joints: tuple[str, ...] = Field(min_length=1, max_length=32)
    home: Joints
    cspace: CSpace
    spheres: dict[str, tuple[CollisionSphere, ...]]
    collision: dict[str, tuple[CollisionPrimitive, ...]]
    self_collision_ignore: tuple[tuple[str, str], ...]
    interpolation_dt: Annotated[float, Field(ge=0.001, le=0.1)] = 0.01
    execution: Execution = Execution()
    strategy: str = "emulator"
    strategy_params: StrategyParams | None = None

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        count = len(self.joints)
        vectors: Mapping[str, tuple[float, ...]] = {
            "home": self.home,
            "cspace.velocity": self.cspace.velocity,
            "cspace.acceleration": self.cspace.acceleration,
            "cspace.jerk": self.cspace.jerk,
        }
        faults = ["joints: a name stands twice"] if len(set(self.joints)) != count else []
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
        if self.strategy_params is not None:
            faults += [f"strategy_params.{fault}" for fault in self.strategy_params.faults(self.joints)]
            period, chunk = self.execution.control_period, self.strategy_params.chunk_period
            streamed = any(DRIVER_STRATEGIES[name] == "chunks" for name in self.strategy_params.strategies)
            if streamed and not _is_multiple(chunk, period):
                faults.append(
                    f"strategy_params.chunk_period: {chunk:g} s is no whole number of periods of the control loop, so that "
                    f"chunks would not come evenly; use a multiple of {period:g} s, or change execution.control_rate"
                )
        if faults:
            raise ValueError("\n".join(map(one_line, faults)))
        return self


@dataclass(frozen=True)
class Robot:
    """A descriptor together with its URDF's kinematics.

    `path` is the descriptor's file. `lower` and `upper` are the position limits of `descriptor.joints` (rad), from the URDF; a continuous joint gets
    +-2 pi. `hash` names this exact content: two services that show different hashes know different robots.
    """

    descriptor: RobotDescriptor
    path: Path
    urdf: Urdf
    urdf_path: Path
    lower: tuple[float, ...]
    upper: tuple[float, ...]
    hash: str


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


def load_robot(name_or_path: str) -> Robot:
    """Read and check a descriptor and its URDF. Raises InvalidRequest with file, line and remedy; one line per fault."""
    document = read_document(find_robot(name_or_path))
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
    urdf = load_urdf(urdf_path)
    faults = _against_urdf(descriptor, urdf)
    if faults:
        raise InvalidRequest("\n".join(document.fault(key, message) for key, message in faults))
    limits = {joint.name: (joint.lower, joint.upper) for joint in urdf.joint_of_child.values()}
    return Robot(
        descriptor=descriptor,
        path=document.path,
        urdf=urdf,
        urdf_path=urdf_path,
        lower=tuple(-math.tau if (low := limits[name][0]) is None else low for name in descriptor.joints),
        upper=tuple(math.tau if (high := limits[name][1]) is None else high for name in descriptor.joints),
        hash=hashlib.sha256(document.text.encode() + urdf_path.read_bytes()).hexdigest()[:16],
    )


def _against_urdf(robot: RobotDescriptor, urdf: Urdf) -> list[tuple[KeyPath, str]]:
    """Faults of the descriptor that only show beside its URDF, with the path of the key to blame."""
    named: dict[KeyPath, str] = {("base_link",): robot.base_link, ("tip_link",): robot.tip_link}
    named |= {("spheres", link): link for link in robot.spheres}
    named |= {("collision", link): link for link in robot.collision}
    named |= {
        ("self_collision_ignore", index, side): link
        for index, pair in enumerate(robot.self_collision_ignore)
        for side, link in enumerate(pair)
    }
    faults: list[tuple[KeyPath, str]] = [
        (key, f"the link {link} is not in {robot.urdf}; the links there are {', '.join(urdf.links)}")
        for key, link in named.items()
        if link not in urdf.links
    ]
    if faults:
        return faults
    try:
        chain = urdf.chain(robot.base_link, robot.tip_link)
    except InvalidRequest as error:
        return [(("tip_link",), error.problem.message)]
    moving = [joint for joint in chain if joint.type != "fixed"]
    if tuple(joint.name for joint in moving) != robot.joints:
        names = [joint.name for joint in moving]
        return [(("joints",), f"the moving joints from base_link to tip_link are {names}; list them in this order")]
    for index, (joint, value) in enumerate(zip(moving, robot.home, strict=True)):
        if joint.lower is not None and joint.upper is not None and not joint.lower <= value <= joint.upper:
            limits = f"{joint.lower} to {joint.upper}"
            faults.append((("home", index), f"{value} is outside the limits of {joint.name}: {limits}"))
    return faults + [(("collision", link), fault) for link in robot.collision for fault in _mount(robot, urdf, link)]


def _mount(robot: RobotDescriptor, urdf: Urdf, link: str) -> Iterator[str]:
    """What keeps the robot's joints from telling where a link is."""
    try:
        chain = urdf.chain(robot.base_link, link)
    except InvalidRequest as error:
        yield error.problem.message
        return
    for joint in chain:
        if joint.type != "fixed" and joint.name not in robot.joints:
            yield f'it hangs on {joint.name}, which is none of the robot\'s joints; give that joint type="fixed" in the URDF'


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
            return "; robots/README.md explains what to write here"
        case "extra_forbidden":
            known = {name for section in _Section.__subclasses__() for name in section.model_fields}
            close = difflib.get_close_matches(key, known, 1)
            return f"; did you mean {close[0]}?" if close else "; robots/README.md lists the keys"
        case "union_tag_not_found":
            return "; write kind: sphere, capsule, cylinder or cuboid"
        case "tuple_type":
            return "; write a list: [0.1, 0.2, 0.3]"
        case "string_pattern_mismatch":
            return "; use small letters, digits and _, a letter first"
        case _:
            return ""
