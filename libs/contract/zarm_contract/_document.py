"""A YAML file with the line of each of its keys, so that errors can name the line."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from zarm_contract._faults import one_line
from zarm_contract.errors import InvalidRequest

KeyPath = tuple[int | str, ...]
"""`("cspace", "jerk", 0)`: keys of mappings and indices of lists, from the top of a document."""


@dataclass(frozen=True)
class Document:
    """The mapping `data` in the file `path` with this `text`; `lines` (from 1) are those of the key paths in it."""

    path: Path
    text: str
    data: dict[str, Any]
    lines: Mapping[KeyPath, int]

    def fault(self, key: KeyPath, message: str) -> str:
        """`file:line: key: message`; a missing key is located at the innermost existing one around it."""
        place = key
        while place and place not in self.lines:
            place = place[:-1]
        dotted = ".".join(map(str, key))
        return f"{self.path}:{self.lines.get(place, 1)}: {one_line(f'{dotted}: {message}' if dotted else message)}"


def read_document(path: Path) -> Document:
    """Read a YAML file that holds a mapping. Raises InvalidRequest with file, line and remedy."""
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise InvalidRequest(f"cannot read the robot descriptor {path}: {error}") from error
    try:
        node = yaml.compose(text, Loader=yaml.CSafeLoader)  # ten times as fast, at the start of every service
        data = yaml.load(text, Loader=yaml.CSafeLoader)
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        place = f"{path}:{mark.line + 1}" if mark else str(path)
        reason = one_line(getattr(error, "problem", None) or str(error))
        raise InvalidRequest(f"{place}: not valid YAML: {reason}") from error
    except (AttributeError, KeyError, ValueError) as error:  # a scalar that looks or is tagged like a date, but is none
        raise InvalidRequest(f"{path}: not valid YAML: {one_line(str(error))}; put texts in quotes") from error
    if node is None or not isinstance(data, dict):
        raise InvalidRequest(f"{path}:1: a descriptor is a mapping of keys to values; this file is not")
    lines: dict[KeyPath, int] = {}
    repeated: dict[KeyPath, str] = {}
    for key, line in _places(node):
        if key in lines and not any(key[:end] in repeated for end in range(len(key) + 1)):
            dotted = one_line(".".join(map(str, key)))
            repeated[key] = f"{path}:{line}: {dotted}: also appears in line {lines[key]}; keep one"
        lines.setdefault(key, line)
    if repeated:
        raise InvalidRequest("\n".join(repeated.values()))
    return Document(path, text, data, lines)


def _places(node: yaml.Node, key: KeyPath = (), around: tuple[yaml.Node, ...] = ()) -> Iterator[tuple[KeyPath, int]]:
    """Every key path of a YAML document, outer before inner, and its line."""
    if not around:
        yield key, node.start_mark.line + 1
    if node in around:
        return  # an alias of a node that contains it
    if isinstance(node, yaml.MappingNode):
        for name, value in node.value:
            yield (*key, name.value), name.start_mark.line + 1
            yield from _places(value, (*key, name.value), (*around, node))
    elif isinstance(node, yaml.SequenceNode):
        for index, value in enumerate(node.value):
            yield (*key, index), value.start_mark.line + 1
            yield from _places(value, (*key, index), (*around, node))
