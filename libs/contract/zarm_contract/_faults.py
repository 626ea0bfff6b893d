"""Names the place of a validation error in the terms of the data's author."""

from __future__ import annotations

import difflib
from collections.abc import Iterator, Sequence
from types import UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from pydantic import BaseModel

TAGS = ("kind", "op")
"""The fields that distinguish the members of a union, in every model of zarm."""
SHAPES = ("listed", "packed", "bound", "keyword")
"""The tags of unions whose members are told apart by what they are: a list or a text, a number or a word."""

_MAX_COMPARED_LENGTH = 100
"""So much of an unknown field's name is compared with known ones: a payload of megabytes may be one name."""


def field_path(location: Sequence[int | str], data: object) -> tuple[int | str, ...]:
    """The path of a fault in `data`, from the `loc` of pydantic's error.

    Pydantic puts the tag of a union's member into the path (`goal.pose.position`); it is not a field and is removed.
    Data without a union may be omitted.
    """
    path: list[int | str] = []
    for part in location:
        if part in SHAPES:
            continue
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


def remedy(model: type[BaseModel], location: Sequence[int | str], kind: str) -> str:
    """What to write where something is missing in data for `model`, or instead of a field that it does not have, from the `loc` and
    `type` of pydantic's error; "" for other faults.
    """
    if kind == "extra_forbidden":
        return _known(model, location)
    if kind not in ("missing", "union_tag_not_found"):
        return ""
    choices = [
        f'"{choice}"' for each in _members(_annotation(model, location)) for choice in (_tags(each) or _literals(each))
    ]
    if not choices:
        return "; docs/reference/messages.md explains what to write here"
    *others, last = choices
    return f"; write {', '.join(others)} or {last}" if others else f"; write {last}"


def _known(model: type[BaseModel], location: Sequence[int | str]) -> str:
    """Which field may be meant by the last part of a location."""
    members = _members(_annotation(model, location[:-1]))
    fields = [name for member in members for name in getattr(member, "model_fields", ())]
    close = difflib.get_close_matches(str(location[-1])[:_MAX_COMPARED_LENGTH], fields, 1)
    return f"; did you mean {close[0]}?" if close else "; docs/reference/messages.md lists the fields"


def _annotation(model: type[BaseModel], location: Sequence[int | str]) -> Any:
    """The annotation of what is at a location in data for `model`."""
    found: Any = model
    for part in location:
        found = _inside(found, part)
    return found


def _inside(annotation: Any, part: int | str) -> Any:
    """The annotation of a part of the data for another one: of a field, of the union's member with this tag, or of a row's values."""
    members = tuple(_members(annotation))
    for member in members:
        if part in _tags(member):
            return member
    for member in members:
        if isinstance(member, type) and issubclass(member, BaseModel):
            if part in member.model_fields:
                return member.model_fields[str(part)].annotation
        elif isinstance(part, int) and get_args(member):
            return get_args(member)[0]
    return None


def _members(annotation: Any) -> Iterator[Any]:
    """Those of a union, or the annotation alone."""
    origin = get_origin(annotation)
    if origin is Annotated:
        yield from _members(get_args(annotation)[0])
    elif origin in (Union, UnionType):
        for member in get_args(annotation):
            yield from _members(member)
    else:
        yield annotation


def _tags(member: Any) -> tuple[str, ...]:
    """The tags of a union's member."""
    if not (isinstance(member, type) and issubclass(member, BaseModel)):
        return ()
    fields = [member.model_fields[tag] for tag in TAGS if tag in member.model_fields]
    return tuple(choice for field in fields for choice in _literals(field.annotation))


def _literals(annotation: Any) -> tuple[str, ...]:
    return get_args(annotation) if get_origin(annotation) is Literal else ()
