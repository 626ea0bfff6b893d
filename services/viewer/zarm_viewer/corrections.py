"""Writes corrections of home, spheres and ignored pairs into the file of a robot descriptor."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Self, cast

import yaml

from zarm_contract.collision import CollisionSphere
from zarm_contract.descriptor import RobotDescriptor
from zarm_contract.errors import InvalidRequest
from zarm_contract.robot import RobotDescription, load_robot

Pair = tuple[str, str]


@dataclass(frozen=True)
class Corrections:
    """What the user may correct: the home (J,) in rad, the spheres of each link in its frame, and the pairs that are
    never checked.
    """

    home: tuple[float, ...]
    spheres: Mapping[str, tuple[CollisionSphere, ...]]
    ignored: tuple[Pair, ...]

    @classmethod
    def of(cls, descriptor: RobotDescriptor) -> Self:
        """Those of a descriptor."""
        return cls(descriptor.home, descriptor.spheres, descriptor.self_collision_ignore)

    def write(self, robot: RobotDescription) -> RobotDescription:
        """Write them into the robot's file, leaving the rest unchanged; returns the robot read back from it.

        Raises InvalidRequest if the result is not a valid descriptor, or if the file has been changed by others; the
        file then stays as it is.
        """
        file = robot.path
        text = file.read_text(encoding="utf-8")
        if load_robot(str(file)).hash != robot.hash:
            raise InvalidRequest(f"{file} or its URDF has changed since it was read here; open the page again")
        with tempfile.NamedTemporaryFile("w", dir=file.parent, suffix=".yaml", encoding="utf-8", delete=False) as draft:
            draft.write(self._written(text, robot.descriptor))
        try:
            made = load_robot(draft.name)
            if made.descriptor != robot.descriptor.model_copy(update=self._fields()):
                raise InvalidRequest(
                    f"{file} cannot be corrected here, because its sections share values; write it by hand"
                )
            Path(draft.name).chmod(file.stat().st_mode)
            Path(draft.name).replace(file)
        except InvalidRequest as error:
            raise InvalidRequest(error.problem.message.replace(draft.name, str(file))) from error
        finally:
            Path(draft.name).unlink(missing_ok=True)
        return load_robot(str(file))

    def _fields(self) -> dict[str, object]:
        return {"home": self.home, "spheres": dict(self.spheres), "self_collision_ignore": self.ignored}

    def _written(self, text: str, before: RobotDescriptor) -> str:
        """The text of a descriptor with the changed sections replaced."""
        was = Corrections.of(before)
        lines = text.splitlines()
        if self.home != was.home:
            lines = _replaced(lines, "home", [f"home: {_flow(list(self.home))}"])
        if self.spheres != was.spheres:
            lines = _replaced(lines, "spheres", ["spheres:", *_spheres(self.spheres)])
        if self.ignored != was.ignored:
            lines = _replaced(lines, "self_collision_ignore", _pairs(self.ignored, _remarks(lines)))
        return "\n".join(lines) + "\n"


def _replaced(lines: Sequence[str], key: str, section: Sequence[str]) -> list[str]:
    """Lines with the section of a top-level key replaced; comments above the next section stay."""
    begin, end = _section(lines, key)
    return [*lines[:begin], *section, *lines[end:]]


def _section(lines: Sequence[str], key: str) -> tuple[int, int]:
    """The first line of a section, and the line after its last one."""
    root = cast(yaml.MappingNode, yaml.compose("\n".join(lines), yaml.CSafeLoader))
    starts = {name.value: name.start_mark.line for name, _ in root.value}
    begin = starts[key]
    end = min((start for start in starts.values() if start > begin), default=len(lines))
    while not lines[end - 1].strip() or lines[end - 1].startswith("#"):
        end -= 1
    return begin, end


def _spheres(spheres: Mapping[str, Sequence[CollisionSphere]]) -> list[str]:
    lines = []
    for link, balls in spheres.items():
        rows = (f"    - {_flow({'center': list(ball.center), 'radius': ball.radius})}" for ball in balls)
        lines += [f"  {_name(link)}:", *rows] if balls else [f"  {_name(link)}: []"]
    return lines


def _pairs(pairs: Sequence[Pair], remarks: Mapping[Pair, str]) -> list[str]:
    rows = [f"  - {_flow(list(pair))}{remarks.get(pair, '')}" for pair in pairs]
    return ["self_collision_ignore:", *rows] if rows else ["self_collision_ignore: []"]


def _remarks(lines: Sequence[str]) -> dict[Pair, str]:
    """The comment after each ignored pair on its own line, which says why it is ignored."""
    begin, end = _section(lines, "self_collision_ignore")
    found = {}
    for line in lines[begin + 1 : end]:
        pair, sign, remark = line.partition(" #")
        match yaml.safe_load(pair):
            case [[str(first), str(second)]] if sign:
                found[first, second] = f"  #{remark}"
    return found


def _flow(value: object) -> str:
    return yaml.safe_dump(value, default_flow_style=True, sort_keys=False, width=1000).strip()


def _name(link: str) -> str:
    return _flow([link])[1:-1]
