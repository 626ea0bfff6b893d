"""Messages to bytes and back: JSON, with the schema `zarm.<Message>.v4` as encoding."""

from __future__ import annotations

import functools
import json
import re
from typing import TypeVar

from pydantic import ValidationError

from zarm_contract._faults import TAGS, field_path, remedy, sentence
from zarm_contract._model import Message
from zarm_contract.errors import InvalidRequest

M = TypeVar("M", bound=Message)

CONTRACT = "v4"
"""Version of the messages and keys; it must be the same on the whole bus."""
_SCHEMA = re.compile(r"zarm\.\w+\.(v\d+)$")
MAX_BYTES = Message.max_bytes
"""Largest payload accepted, of any message."""
QUOTED = 500
"""Longest quotation, in characters, from a payload in its refusal."""
MAX_FIELDS = 100_000
"""Most fields in a payload; a scene of 10,000 objects has 60,000."""
MAX_VALUES = 1_000_000
"""Most values in a payload; the longest trajectory has some 500,000, 200,000 voxels have 800,000."""
LONG = 64 * 1024
"""A larger payload (bytes) is inspected before it is parsed: every fault that the parser finds costs a copy of the
values around it, which can add up to seconds and gigabytes.
"""


def build_all(model: type[Message] = Message) -> None:
    """Build the serializers and validators of this class and all derived from it, at once: 0.1 s.

    Otherwise each is built when its first message comes, in some ms that a robot in motion may not have.
    """
    model.model_rebuild()
    for derived in model.__subclasses__():
        build_all(derived)


def schema(model: type[Message]) -> str:
    """The schema name of a message class: `zarm.Plan.v4`."""
    return f"zarm.{model.__name__}.{CONTRACT}"


@functools.lru_cache(256)
def other_contract(encoding: str) -> str | None:
    """The contract in an encoding or schema name if it differs from this one; None if it names none."""
    found = _SCHEMA.search(encoding)
    return found[1] if found is not None and found[1] != CONTRACT else None


def encode(message: Message) -> bytes:
    """A message as compact UTF-8 JSON, without fields that are None; numbers may be NumPy's."""
    import orjson  # not by a short command, which only reads

    content = orjson.dumps(message, default=_fields, option=orjson.OPT_SERIALIZE_NUMPY)
    # A copy of its own size: orjson cuts its bytes from larger blocks, which fragment the heap where they are kept.
    return bytes(memoryview(content))


def _fields(message: object) -> dict[str, object]:
    """The fields of a message, for orjson, which writes the rest by itself: rows of numbers in a fifth of pydantic's time."""
    if not isinstance(message, Message):
        raise TypeError(f"a message cannot hold a {type(message).__name__}")
    return {name: value for name, value in message.__dict__.items() if value is not None}


def decode(model: type[M], payload: bytes) -> M:
    """Read a message; no payload at all reads as `{}`. Raises InvalidRequest that names the first field at fault."""
    if len(payload) > model.max_bytes:
        raise InvalidRequest(
            f"the payload of {len(payload)} bytes is over the limit of {model.max_bytes} for {model.__name__}; send less at "
            "once",
            field="payload",
        )
    if len(payload) > LONG:
        _look_over(model, payload)
    payload = payload or b"{}"
    try:
        return model.model_validate_json(payload)
    except ValidationError as error:
        first, *others = error.errors(include_url=False, include_input=False)
        path = field_path(first["loc"], json.loads(payload) if first["loc"] and _tagged(payload) else None)
        # A faulty row is also reported as one that lacks the faulty item.
        count = sum(other["loc"] != first["loc"][: len(other["loc"])] for other in others)
        more = f"; and {count} more" if count else ""
        said = _cut(sentence(first["msg"])) + remedy(model, first["loc"], first["type"])
        raise InvalidRequest(f"{model.__name__}: {said}{more}", field=_cut(".".join(map(str, path))) or None) from error


def _look_over(model: type[Message], payload: bytes) -> None:
    """Refuse cheaply what cannot be a message of this class."""
    for sign, most, what in ((b":", MAX_FIELDS, "fields"), (b",", MAX_VALUES, "values")):
        if payload.count(sign) > most:
            raise InvalidRequest(f"{model.__name__}: more than {most} {what}; send less at once", field="payload")
    for name, field in model.model_fields.items():
        if field.is_required() and f'"{name}"'.encode() not in payload:
            raise InvalidRequest(f"{model.__name__}: Field required{remedy(model, (name,), 'missing')}", field=name)


def _tagged(payload: bytes) -> bool:
    """Whether the path of a fault may contain tags of a union; this avoids parsing millions of values again."""
    return any(f'"{tag}"'.encode() in payload for tag in TAGS)


def _cut(text: str) -> str:
    """Limits the length of quotations from a payload in answers and logs."""
    return text if len(text) <= QUOTED else f"{text[:QUOTED]}..."
