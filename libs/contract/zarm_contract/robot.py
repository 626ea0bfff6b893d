"""A robot: its descriptor with the kinematics of its URDF, read with errors that name the file and the line."""

from __future__ import annotations

import difflib
import hashlib
import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from pydantic import ValidationError

from zarm_contract._faults import field_path, sentence
from zarm_contract.descriptor import CSpace, RobotDescriptor
from zarm_contract.document import Document, KeyPath, read_document
from zarm_contract.errors import InvalidRequest
from zarm_contract.section import Section
from zarm_contract.urdf import Urdf, load_urdf

ROBOTS = Path(__file__).parent / "robots"
"""The descriptors that come with zarm."""

_HALF_TURN = math.pi + 1e-6
"""Half a turn (rad), and a little more, so that no rounding makes two halves less than a turn."""


@dataclass(frozen=True)
class RobotDescription:
    """A descriptor together with its URDF's kinematics.

    `path` is the descriptor's file. `urdf` has a link for the tip of each of its tools too. `lower` and `upper` are the position limits of `descriptor.joints` (rad), from
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
        """Raise InvalidRequest for `field` unless the group has exactly one tip; without a group, unless the robot has one tip that all joints move."""
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

    def with_tools(self, names: Collection[str]) -> RobotDescription:
        """This robot with these of its tools mounted: their tips take the place of those of the links that carry them. Raises InvalidRequest."""
        if not names:
            return self
        descriptor = self.descriptor
        if unknown := set(names) - descriptor.tools.keys():
            raise InvalidRequest(f"{descriptor.name} has no tool {', '.join(sorted(unknown))} in {self.path}")
        tip_of = {descriptor.tools[name].link or descriptor.tip_link: name for name in names}
        groups = {
            name: group.model_copy(update={"tip_link": tip_of.get(group.tip_link, group.tip_link)})
            if group.tip_link is not None
            else group
            for name, group in descriptor.groups.items()
        }
        tip_link = tip_of.get(descriptor.tip_link, descriptor.tip_link)
        return replace(self, descriptor=descriptor.model_copy(update={"tip_link": tip_link, "groups": groups}))

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
        urdf=urdf.with_frames([tool.frame(name, descriptor.tip_link) for name, tool in descriptor.tools.items()]),
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
    named |= {("cameras", name, "link"): camera.link for name, camera in robot.cameras.items() if camera.link}
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
        (("payloads", link), f"the link {link} is not in the URDF; the links there are {', '.join(urdf.links)}")
        for link in robot.payloads
        if link not in urdf.links
    ]
    faults += [
        (("grippers", name, key), fault)
        for name, gripper in robot.grippers.items()
        for key, fault in gripper.faults_in(urdf, robot.joints)
    ]
    faults += [
        (("tools", name, key), fault)
        for name, tool in robot.tools.items()
        for key, fault in tool.faults_in(name, urdf, robot.collision)
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
