"""The SRDF of a robot, in which MoveIt keeps its groups, end effectors and named states."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Self

from zarm_contract.errors import InvalidRequest
from zarm_contract.urdf_document import UrdfDocument, parse_urdf
from zarm_robot_import.chain import Chain
from zarm_robot_import.description import Description

_HOMES = ("home", "ready", "default")
"""Names of states that are taken as home, best first."""
_ARM = 4
"""Least joints of a group that is an arm."""


@dataclass(frozen=True)
class Srdf:
    """The moving joints of each group, and joint positions of each named state, in the order of the file."""

    groups: Mapping[str, tuple[str, ...]]
    states: Sequence[tuple[str, Mapping[str, float]]]

    @classmethod
    def read(cls, file: Path, robot: Description) -> Self:
        """That of a file. Raises InvalidRequest with file and line."""
        document = _document(file)
        elements = {document.attribute(one, "name"): one for one in document.root.iterfind("group")}
        groups = {name: tuple(dict.fromkeys(_joints(document, elements, name, robot, ()))) for name in elements}
        states = []
        for state in document.root.iterfind("group_state"):
            owner = f"the state {document.attribute(state, 'name')}"
            joints = {
                document.attribute(one, "name"): document.numbers(one, "value", 1, owner)[0]
                for one in state.iterfind("joint")
                if len((one.get("value") or "").split()) == 1  # a floating joint has several
            }
            states.append((document.attribute(state, "name"), joints))
        return cls(groups, tuple(states))

    def home(self, joints: Sequence[str]) -> tuple[float, ...] | None:
        """The positions of these joints in the best state that has all of them; states of one name and several groups are one."""
        for wanted in _HOMES:
            positions: dict[str, float] = {}
            for name, state in self.states:
                if name.lower() == wanted:
                    positions |= state
            if positions.keys() >= {*joints}:
                return tuple(positions[name] for name in joints)
        return None

    def arm(self, robot: Description) -> tuple[str, tuple[str, ...]] | None:
        """The only group that has at least _ARM joints, one behind the other: its name, and these in their order."""
        rows = {}
        for name, own in self.groups.items():
            for joint in robot.joint_of_child.values():
                path = robot.path(robot.root, joint.child) if joint.name in own else None
                row = tuple(one.name for one in path or () if one.name in own)
                if len(row) == len(own) >= _ARM:
                    rows[row] = name
        return next(((name, row) for row, name in rows.items()), None) if len(rows) == 1 else None

    def renamed(self, chain: Chain) -> Chain:
        """The chain with the names that the SRDF has for groups of the same joints."""
        names = {group.name: self.name_of(group.joints) for group in chain.groups if "+" not in group.name}
        if len({*filter(None, names.values())}) < len([*filter(None, names.values())]):
            return chain
        return replace(
            chain,
            groups=tuple(
                replace(group, name="+".join(names.get(part) or part for part in group.name.split("+")))
                for group in chain.groups
            ),
        )

    def name_of(self, joints: Collection[str]) -> str | None:
        """The name of the group of exactly these joints, in a form that a descriptor accepts."""
        return next((_plain(name) for name, own in self.groups.items() if {*own} == {*joints}), None)

    def gripper_of(self, driven: str, joints: Collection[str]) -> str | None:
        """The name of the group that has the `driven` joint of a gripper, and besides only others of its `joints`."""
        groups = self.groups.items()
        return next((_plain(name) for name, own in groups if driven in own and {*own} <= {driven, *joints}), None)


def srdf_beside(robot: Description) -> Path | None:
    """The SRDF that lies beside a URDF and is of a robot with its name; None if there is none, or several."""
    own = [file for file in robot.source.srdfs if _document(file).root.get("name") == robot.name]
    if len(own) > 1:
        own = [file for file in own if file.stem == robot.source.path.stem]
    return own[0] if len(own) == 1 else None


def _document(file: Path) -> UrdfDocument:
    try:
        return parse_urdf(file, file.read_bytes())
    except OSError as error:
        raise InvalidRequest(f"cannot read {file}: {error.strerror or error}", field="--srdf") from error


def _plain(name: str) -> str | None:
    """A name in a form that a descriptor accepts."""
    plain = re.sub(r"[^a-z0-9]+", "_", name.lower()).strip("_")
    return plain if re.fullmatch(r"[a-z][a-z0-9_]{0,63}", plain) else None


def _joints(
    document: UrdfDocument, elements: Mapping[str, ET.Element], name: str, robot: Description, above: tuple[str, ...]
) -> Iterator[str]:
    """The moving joints of a group: those that it names, the parents of its links, those of its chains, and those of its subgroups."""
    if name not in elements or name in above:
        fault = "contains itself" if name in above else "is not there"
        raise InvalidRequest(
            f"{document.path}: the group {name} {fault}; correct the SRDF, or leave it out", field="--srdf"
        )
    joints = {joint.name: joint for joint in robot.joint_of_child.values()}
    for one in elements[name]:
        if one.tag == "group":
            yield from _joints(document, elements, document.attribute(one, "name"), robot, (*above, name))
            continue
        if one.tag == "chain":
            path = robot.path(document.attribute(one, "base_link"), document.attribute(one, "tip_link")) or []
        elif one.tag == "link":
            path = [
                robot.joint_of_child[link]
                for link in (document.attribute(one, "name"),)
                if link in robot.joint_of_child
            ]
        else:
            path = [joints[joint] for joint in (document.attribute(one, "name"),) if joint in joints]
        yield from (joint.name for joint in path if joint.type != "fixed")
