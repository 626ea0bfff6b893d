"""Names the place of a validation error as the author of the data knows it."""

from __future__ import annotations

from collections.abc import Sequence

TAGS = ("kind", "op")
"""The fields that tell the members of a union apart, in every model of zarm."""


def field_path(location: Sequence[int | str], data: object) -> tuple[int | str, ...]:
    """The path of a fault in `data`, from the `loc` of pydantic's error.

    Pydantic puts the tag of a union's member into the path (`goal.pose.position`); it is no field and is left out. Data
    without a union needs not be given.
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
    """A text without the line breaks that it quotes or that whoever wrote it put there: each fault has a line."""
    return " ".join(text.split())


def sentence(message: str) -> str:
    """Pydantic's message without the words that it puts before a rule of ours."""
    return message.removeprefix("Value error, ")
