"""The one reader of YAML: a file whose every value is what YAML 1.2 says, and whose errors name the line.

PyYAML alone keeps the last of two equal keys, reads `4e-1` as a text, `no` as false, `010` as 8 and `1:30` as 90.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from zarm_contract._faults import one_line
from zarm_contract.errors import InvalidRequest

KeyPath = tuple[int | str, ...]
"""`("cspace", "jerk", 0)`: keys of mappings and indices of lists, from the top of a document."""

MAX_VALUES = 2_000_000
"""Most values in a file, each alias counted in full: twice as many as a message may have, and built in seconds."""

_CORE = "tag:yaml.org,2002:"
_TAGS = {_CORE + name for name in ("map", "seq", "str", "int", "float", "bool", "null")}


class _Loader(yaml.CSafeLoader):  # ten times as fast as SafeLoader, at the start of every service
    yaml_implicit_resolvers = {}  # noqa: RUF012 - PyYAML declares it so


# https://yaml.org/spec/1.2.2/#103-core-schema, but with texts for decimal integers that begin with 0: octal in YAML 1.1.
for _tag, _pattern, _first in (
    ("bool", r"true|True|TRUE|false|False|FALSE", "tTfF"),
    ("int", r"[-+]?(?:0|[1-9][0-9]*)|0o[0-7]+|0x[0-9a-fA-F]+", "-+0123456789"),
    (
        "float",
        r"[-+]?(?:(?:\.[0-9]+|[0-9]+\.[0-9]*)(?:[eE][-+]?[0-9]+)?|[0-9]+[eE][-+]?[0-9]+|\.inf|\.Inf|\.INF)|\.nan|\.NaN|\.NAN",
        "-+.0123456789",
    ),
    ("null", r"~|null|Null|NULL|", ["~", "n", "N", ""]),
    ("merge", r"<<", "<"),
):
    _Loader.add_implicit_resolver(_CORE + _tag, re.compile(rf"(?:{_pattern})\Z"), list(_first))


def _mapping(loader: _Loader, node: yaml.MappingNode) -> Iterator[dict[str, Any]]:
    """A mapping whose keys are texts as written: a name such as `on`, `7` or `1e3` is no other value."""
    data: dict[str, Any] = {}
    yield data
    loader.flatten_mapping(node)
    for key, value in node.value:
        data[key.value] = loader.construct_object(value, deep=True)


_Loader.add_constructor(_CORE + "map", _mapping)


@dataclass(frozen=True)
class Document:
    """The mapping `data` in the file `path` with this `text`."""

    path: Path
    text: str
    data: dict[str, Any]
    _root: yaml.Node

    def line(self, key: KeyPath) -> int:
        """The line (from 1) of a key; of a missing key, that of the innermost existing one around it."""
        node, line = self._root, self._root.start_mark.line
        for part in key:
            if isinstance(node, yaml.MappingNode):
                found = [(name, value) for name, value in node.value if name.value == part]
            elif isinstance(node, yaml.SequenceNode) and isinstance(part, int) and part < len(node.value):
                found = [(node.value[part], node.value[part])]
            else:
                found = []
            if not found:
                break
            named, node = found[-1]  # what is merged stands before what replaces it
            line = named.start_mark.line
        return line + 1

    def place(self, field: str) -> str:
        """`file:line` of the field of a problem, such as `objects.0.radius`."""
        return f"{self.path}:{self.line(tuple(int(part) if part.isdecimal() else part for part in field.split('.')))}"

    def fault(self, key: KeyPath, message: str) -> str:
        """`file:line: key: message`."""
        dotted = ".".join(map(str, key))
        return f"{self.path}:{self.line(key)}: {one_line(f'{dotted}: {message}' if dotted else message)}"


def read_document(path: Path, what: str) -> Document:
    """Read a YAML file that holds one mapping; `what` says what it is, such as `a robot descriptor`.

    Raises InvalidRequest with file, line and remedy for anything else: two equal keys, several documents, tags beyond YAML's
    core schema, aliases that contain themselves.
    """
    try:
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, ValueError) as error:  # ValueError: no UTF-8, or a null character in the path
        raise InvalidRequest(f"cannot read {path} as {what}: {getattr(error, 'strerror', None) or error}") from error
    try:
        loader = _Loader(text)
        root = loader.get_single_node()
        faults = [] if root is None else _checked(root, path)
        data = None if root is None or faults else loader.construct_document(root)
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        place = f"{path}:{mark.line + 1}" if mark else str(path)
        reason = one_line(getattr(error, "problem", None) or str(error))
        if reason == "but found another document":
            reason = "it holds a second document; put each into a file of its own"
        raise InvalidRequest(f"{place}: not valid YAML: {reason}") from error
    except (
        ValueError,
        RecursionError,
    ) as error:  # a value that is tagged as a number and is none; brackets in brackets
        reason = "it is nested too deeply" if isinstance(error, RecursionError) else one_line(str(error))
        raise InvalidRequest(f"{path}: not valid YAML: {reason}") from error
    if faults:
        raise InvalidRequest("\n".join(faults))
    if root is None or not isinstance(data, dict):
        raise InvalidRequest(f"{path}:1: {what} is a mapping of keys to values; this file is not")
    return Document(path, text, data, root)


def _checked(root: yaml.Node, path: Path) -> list[str]:
    """What PyYAML would read otherwise than it is written, one line per fault."""
    faults: list[str] = []
    counts: dict[int, int] = {}

    def fault(node: yaml.Node, key: KeyPath, message: str) -> None:
        dotted = one_line(".".join(map(str, key)))
        place = f"{path}:{node.start_mark.line + 1}"
        faults.append(f"{place}: {dotted}: {message}" if dotted else f"{place}: {message}")

    def count(node: yaml.Node, key: KeyPath) -> int:
        if isinstance(node, yaml.ScalarNode) and node.tag in _TAGS:
            return 1
        if id(node) not in counts:
            counts[id(node)] = 0  # while it is being counted
            counts[id(node)] = _count(node, key, count, fault)
        elif not counts[id(node)]:
            fault(node, key, "it contains itself through an alias; write the values out")
        return counts[id(node)]

    if count(root, ()) > MAX_VALUES and not faults:
        faults.append(f"{path}: more than {MAX_VALUES} values with all aliases written out; put less into one file")
    return faults


def _count(
    node: yaml.Node,
    key: KeyPath,
    count: Callable[[yaml.Node, KeyPath], int],
    fault: Callable[[yaml.Node, KeyPath, str], None],
) -> int:
    """How many values a node holds."""
    if node.tag not in _TAGS:
        tag = one_line(node.tag.replace(_CORE, "!!"))
        fault(node, key, f"not valid YAML here: the tag {tag} has no meaning; write a plain value")
        return 1
    if isinstance(node, yaml.SequenceNode):
        return 1 + sum(count(item, (*key, index)) for index, item in enumerate(node.value))
    total, lines = 1, dict[str, int]()
    for name, value in node.value:
        if not isinstance(name, yaml.ScalarNode):
            fault(name, key, "a key is a text, and this one is not")
            continue
        if name.value in lines:
            fault(name, (*key, name.value), f"also appears in line {lines[name.value]}; keep one")
            continue
        lines[name.value] = name.start_mark.line + 1
        total += count(value, (*key, name.value))
    return total
