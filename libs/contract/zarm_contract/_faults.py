"""Names the place of a validation error in the terms of the data's author."""

from __future__ import annotations

from collections.abc import Sequence

TAGS = ("kind", "op")
"""The fields that distinguish the members of a union, in every model of zarm."""


def field_path(location: Sequence[int | str], data: object) -> tuple[int | str, ...]:
    """The path of a fault in `data`, from the `loc` of pydantic's error.

    Pydantic puts the tag of a union's member into the path (`goal.pose.position`); it is not a field and is removed.
    Data without a union may be omitted.
    """
    path: list[int | str] = []
    for part in location:
        if isinstance(data, dict):
            if part not in data and part in (data.get(tag) for tag in TAGS):
                continue
            data = data.get(part)
        elif isinstance(data, list) and isinstance(part, int):
            data = data[part] if part < len(data) else None
        path.append(part)
    return tuple(path)


def one_line(text: str) -> str:
    """A text without line breaks, whether quoted or original, since each fault has one line."""
    return " ".join(text.split())


def sentence(message: str) -> str:
    """Pydantic's message without its prefix to our own rules."""
    return message.removeprefix("Value error, ")
