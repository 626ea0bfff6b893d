"""The fields of every message of curobo_msgs in each generation, read from its definitions."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from pathlib import Path

GENERATIONS = ("a", "b", "c")
FOLDER = Path(__file__).with_name("curobo_msgs")

Fields = Mapping[str, str]
"""Types by name, in wire order, as in `get_fields_and_field_types` of a message class."""

_PARTS = {".msg": ("",), ".srv": ("Request", "Response"), ".action": ("Goal", "Result", "Feedback")}
_PYTHON = {"bool": "boolean", "float32": "float", "float64": "double"}


def definitions(generation: str) -> dict[str, dict[str, Fields]]:
    """For each type, like srv/AddObject, the fields of its parts: "" for a message, Request and Response for a service."""
    return {
        f"{path.parent.name}/{path.stem}": dict(
            zip(_PARTS[path.suffix], map(dict, map(_fields, _sections(path.read_text()))), strict=True)
        )
        for folder in sorted(FOLDER.iterdir())
        if folder.is_dir() and generation in folder.name
        for path in sorted(folder.glob("*/*"))
        if path.suffix in _PARTS
    }


def _sections(text: str) -> list[str]:
    return re.split(r"^---$", text, flags=re.MULTILINE)


def _fields(section: str) -> Iterator[tuple[str, str]]:
    for line in section.splitlines():
        words = line.partition("#")[0].split()
        if words and "=" not in words:  # otherwise a constant
            yield words[1], _python(words[0])


def _python(kind: str) -> str:
    if kind.endswith("[]"):
        return f"sequence<{_python(kind.removesuffix('[]'))}>"
    return f"curobo_msgs/{kind}" if kind[0].isupper() else _PYTHON.get(kind, kind)
