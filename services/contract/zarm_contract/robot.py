"""The robot descriptor, `robots/<name>.yaml`: one model, and errors that name the file and the line."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal, Self

import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from zarm_contract.errors import InvalidRequest
from zarm_contract.messages import Joints, NonNegative, Positive, Quaternion, Scale, Vector3
from zarm_contract.urdf import Urdf, load_urdf

ROBOTS = Path(__file__).parent / "robots"
"""The descriptors that come with zarm."""


class _Section(BaseModel):
    # A descriptor is written by hand, so 1 may stand for 1.0 and a list for a tuple; nothing else is forgiven.
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
    allowed duration 1.1 x + 0.5 s (MoveIt), stopped below 0.01 rad/s (ros2_control).
    """

    start_tolerance: Positive = 0.05
    path_tolerance: Positive = 0.2
    goal_tolerance: Positive = 0.01
    settle_time: Positive = 1.0
    joint_state_timeout: Positive = 0.1
    stopped_velocity: Positive = 0.01
    allowed_duration_factor: Annotated[float, Field(ge=1)] = 1.1
    allowed_duration_margin: NonNegative = 0.5


class RobotDescriptor(_Section):
    """A robot as every service needs it. `urdf` is a path relative to the descriptor's file.

    `joints` are the moving joints from `base_link` to `tip_link` in kinematic order; every joint vector of zarm follows
    it. `spheres` cover `collision` link by link: the first serve fast checks, the second are the exact geometry.
    `interpolation_dt` (s) is the sample period of planned trajectories.
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

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        count = len(self.joints)
        if len(set(self.joints)) != count:
            raise ValueError("joints: a name stands twice")
        vectors: Mapping[str, tuple[float, ...]] = {
            "home": self.home,
            "cspace.velocity": self.cspace.velocity,
            "cspace.acceleration": self.cspace.acceleration,
            "cspace.jerk": self.cspace.jerk,
        }
        for name, vector in vectors.items():
            if len(vector) != count:
                raise ValueError(f"{name}: {len(vector)} values for {count} joints")
        for link in self.collision:
            if not self.spheres.get(link):
                raise ValueError(f"spheres: the link {link} has collision geometry but no sphere that covers it")
        for link in self.spheres:
            if not self.collision.get(link):
                raise ValueError(f"collision: the link {link} has spheres but no exact geometry")
        return self


@dataclass(frozen=True)
class Robot:
    """A descriptor together with its URDF's kinematics.

    `lower` and `upper` are the position limits of `descriptor.joints` (rad), from the URDF; a continuous joint gets
    +-2 pi. `hash` names this exact content: two services that show different hashes know different robots.
    """

    descriptor: RobotDescriptor
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
    path = find_robot(name_or_path)
    text = path.read_text(encoding="utf-8")
    try:
        data = yaml.safe_load(text)
        lines = _line_of(yaml.compose(text, Loader=yaml.SafeLoader))
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        place = f"{path}:{mark.line + 1}" if mark else str(path)
        raise InvalidRequest(f"{place}: not valid YAML: {getattr(error, 'problem', None) or error}") from error
    if not isinstance(data, dict):
        raise InvalidRequest(f"{path}:1: a descriptor is a mapping of keys to values; this file is not")
    try:
        descriptor = RobotDescriptor.model_validate(data)
    except ValidationError as error:
        raise InvalidRequest(
            "\n".join(_explain(path, lines, fault.get("loc", ()), fault["msg"]) for fault in error.errors())
        ) from error
    urdf_path = path.parent / descriptor.urdf
    urdf = load_urdf(urdf_path)
    faults = _against_urdf(descriptor, urdf)
    if faults:
        raise InvalidRequest("\n".join(_explain(path, lines, loc, message) for loc, message in faults))
    limits = {joint.name: (joint.lower, joint.upper) for joint in urdf.joint_of_child.values()}
    two_pi = 6.283185307179586
    return Robot(
        descriptor=descriptor,
        urdf=urdf,
        urdf_path=urdf_path,
        lower=tuple(-two_pi if (low := limits[name][0]) is None else low for name in descriptor.joints),
        upper=tuple(two_pi if (high := limits[name][1]) is None else high for name in descriptor.joints),
        hash=hashlib.sha256(text.encode() + urdf_path.read_bytes()).hexdigest()[:16],
    )


_Path = tuple[int | str, ...]


def _against_urdf(robot: RobotDescriptor, urdf: Urdf) -> list[tuple[_Path, str]]:
    """Faults of the descriptor that only show beside its URDF, with the path of the key to blame."""
    faults: list[tuple[_Path, str]] = []
    for key in ("base_link", "tip_link"):
        if getattr(robot, key) not in urdf.links:
            faults.append(((key,), f"the link {getattr(robot, key)} is not in {robot.urdf}"))
    for section in ("spheres", "collision"):
        faults += [
            ((section, link), f"the link {link} is not in {robot.urdf}")
            for link in getattr(robot, section)
            if link not in urdf.links
        ]
    for index, pair in enumerate(robot.self_collision_ignore):
        faults += [
            (("self_collision_ignore", index), f"the link {link} is not in {robot.urdf}")
            for link in pair
            if link not in urdf.links
        ]
    if faults:
        return faults
    chain = urdf.chain(robot.base_link, robot.tip_link)
    moving = tuple(joint.name for joint in chain if joint.type != "fixed")
    if moving != robot.joints:
        return [(("joints",), f"the moving joints from base_link to tip_link are {list(moving)}, in this order")]
    by_name = {joint.name: joint for joint in chain}
    for index, (name, value) in enumerate(zip(robot.joints, robot.home, strict=True)):
        joint = by_name[name]
        if joint.lower is not None and joint.upper is not None and not joint.lower <= value <= joint.upper:
            faults.append((("home", index), f"{value} is outside the limits of {name}: {joint.lower} to {joint.upper}"))
    return faults


def _line_of(node: yaml.Node | None, prefix: _Path = ()) -> dict[_Path, int]:
    """The line (from 1) of each key path of a YAML document."""
    lines: dict[_Path, int] = {}
    if node is None:
        return lines
    lines[prefix] = node.start_mark.line + 1
    if isinstance(node, yaml.MappingNode):
        for key, value in node.value:
            lines |= _line_of(value, (*prefix, key.value))
            lines[(*prefix, key.value)] = key.start_mark.line + 1
    elif isinstance(node, yaml.SequenceNode):
        for index, value in enumerate(node.value):
            lines |= _line_of(value, (*prefix, index))
    return lines


def _explain(path: Path, lines: Mapping[_Path, int], loc: _Path, message: str) -> str:
    place = loc
    while place and place not in lines:
        place = place[:-1]
    if not loc:  # a rule over the whole file names its key itself: `home: 5 values for 6 joints`
        key = tuple(message.removeprefix("Value error, ").split(":")[0].split("."))
        place = key if key in lines else place
    dotted = ".".join(str(part) for part in loc)
    return f"{path}:{lines.get(place, 1)}: {dotted + ': ' if dotted else ''}{message.removeprefix('Value error, ')}"
