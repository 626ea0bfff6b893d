"""A URDF as XML: its elements, the line of each, and the numbers and names in their attributes."""

from __future__ import annotations

import math
import re
import xml.etree.ElementTree as ET
from dataclasses import dataclass
from pathlib import Path
from typing import Never
from xml.parsers import expat

from zarm_contract.errors import InvalidRequest

_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)(e[+-]?\d+)?", re.ASCII | re.IGNORECASE)
"""Python's `float` takes more than other readers of URDFs: `1_000`, and digits of any script."""
_INFINITY = re.compile(r"([+-]?)inf(inity)?", re.IGNORECASE)
INFINITE = 1e308
"""Exporters write an infinite limit as the largest double or so; a limit from here on means none."""


@dataclass(frozen=True)
class UrdfDocument:
    """The file, its root element `<robot>`, and the line of each element."""

    path: Path
    root: ET.Element
    lines: dict[ET.Element, int]

    def place(self, element: ET.Element) -> str:
        """`file:line`."""
        return f"{self.path}:{self.lines[element]}"

    def fault(self, element: ET.Element, message: str) -> InvalidRequest:
        """An error with file and line; `message` says the remedy."""
        return InvalidRequest(f"{self.place(element)}: {message}")

    def attribute(self, element: ET.Element, name: str) -> str:
        """A text that must be there. Raises InvalidRequest."""
        value = element.get(name)
        if not value:
            raise self.fault(element, f"a <{element.tag}> has no {name}=")
        return value

    def numbers(
        self,
        element: ET.Element | None,
        name: str,
        count: int,
        owner: str,
        default: tuple[float, ...] | None = None,
    ) -> tuple[float, ...]:
        """`count` finite numbers; without a `default` they must be there. `owner` is named in errors. Raises InvalidRequest."""
        if element is None or (text := element.get(name)) is None:
            if default is None:
                where = self.root if element is None else element
                raise self.fault(where, f"{owner}: its <{where.tag}> has no {name}=; write it")
            return default
        parts = text.split()
        values = tuple(float(part) for part in parts if _NUMBER.fullmatch(part))
        if len(parts) != count or len(values) != count or not all(map(math.isfinite, values)):
            wanted = "a finite number" if count == 1 else f"{count} finite numbers"
            macro = "; this is a xacro file: expand it first with `xacro`" if "$" in text else ""
            raise self.fault(element, f"{owner}: {name}={text!r} must be {wanted}{macro}")
        return values

    def bound(self, element: ET.Element, name: str, owner: str) -> float | None:
        """A limit, which may be infinite; None if it is not stated. Raises InvalidRequest."""
        text = element.get(name)
        if text is None:
            return None
        if infinite := _INFINITY.fullmatch(text.strip()):
            return -math.inf if infinite[1] == "-" else math.inf
        if _NUMBER.fullmatch(text.strip()) and abs(value := float(text)) >= INFINITE:
            return math.copysign(math.inf, value)
        return self.numbers(element, name, 1, owner)[0]

    def origin(
        self, element: ET.Element | None, owner: str
    ) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
        """The `xyz` (m) and `rpy` (rad; Rz(y) Ry(p) Rx(r)) of an <origin>, identity without one. Raises InvalidRequest."""
        x, y, z = self.numbers(element, "xyz", 3, owner, (0.0, 0.0, 0.0))
        if element is None or "quat_xyzw" not in element.attrib:
            roll, pitch, yaw = self.numbers(element, "rpy", 3, owner, (0.0, 0.0, 0.0))
            return (x, y, z), (roll, pitch, yaw)
        if "rpy" in element.attrib:
            raise self.fault(element, f"{owner}: its <origin> has both rpy= and quat_xyzw=; keep one")
        quaternion = self.numbers(element, "quat_xyzw", 4, owner)
        if abs((norm := math.hypot(*quaternion)) - 1.0) > _OFF_UNIT:
            raise self.fault(element, f"{owner}: quat_xyzw= has the norm {norm:.6g}; write a unit quaternion, x y z w")
        return (x, y, z), _roll_pitch_yaw(*(value / norm for value in quaternion))


_OFF_UNIT = 1e-3
"""By so much the norm of a quaternion may differ from 1: what rounding to 4 digits does."""


def parse_urdf(path: Path, text: bytes | str) -> UrdfDocument:
    """The elements of the XML in `text`; errors name `path`. Raises InvalidRequest."""
    lines: dict[ET.Element, int] = {}
    builder = ET.TreeBuilder()
    # Prefixes stay part of the names, as in urdfdom: <drake:joint> is no <joint>, and a prefix need not be declared.
    parser = expat.ParserCreate()

    def start(tag: str, attributes: dict[str, str]) -> None:
        lines[builder.start(tag, attributes)] = parser.CurrentLineNumber

    def external(_context: str, _base: str | None, system: str | None, _public: str | None) -> Never:
        line = parser.CurrentLineNumber
        raise InvalidRequest(f"{path}:{line}: the file includes {system} as an XML entity; write its content here")

    parser.StartElementHandler = start
    parser.EndElementHandler = builder.end
    parser.CharacterDataHandler = builder.data
    parser.ExternalEntityRefHandler = external
    try:
        parser.Parse(text, True)
    except (LookupError, ValueError) as error:  # of an encoding that Python does not know
        raise InvalidRequest(f"{path}: {error}; save the file as UTF-8") from error
    except expat.ExpatError as error:
        reason = expat.ErrorString(error.code)
        raise InvalidRequest(f"{path}:{error.lineno}: not well-formed XML: {reason}") from error
    document = UrdfDocument(path, builder.close(), lines)
    if document.root.tag != "robot":
        raise document.fault(document.root, f"a URDF starts with <robot>; this file starts with <{document.root.tag}>")
    return document


def _roll_pitch_yaw(x: float, y: float, z: float, w: float) -> tuple[float, float, float]:
    """Of a unit quaternion. At a pitch of 90 deg only roll - yaw or roll + yaw is defined; the roll is computed after the yaw,
    so that the rotation stays exact there.
    """
    r00, r10, r20 = 1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)
    r01, r11 = 2 * (x * y - w * z), 1 - 2 * (x * x + z * z)
    r02, r12 = 2 * (x * z + w * y), 2 * (y * z - w * x)
    yaw = math.atan2(r10, r00)
    cos, sin = math.cos(yaw), math.sin(yaw)
    return math.atan2(sin * r02 - cos * r12, cos * r11 - sin * r01), math.atan2(-r20, math.hypot(r00, r10)), yaw
