"""Messages to bytes and back: JSON, with the schema `zarm.<Message>.v1` as encoding."""

from __future__ import annotations

import json
from typing import TypeVar

from pydantic import ValidationError

from zarm_contract._faults import TAGS, field_path, sentence
from zarm_contract._model import Message
from zarm_contract.errors import InvalidRequest

M = TypeVar("M", bound=Message)

MAX_BYTES = Message.max_bytes
"""Largest payload that is read, of any message."""
MAX_FIELDS = 100_000
"""Most fields in a payload; a scene of 10,000 objects has 60,000. Each unknown one would be listed as a fault."""


def schema(model: type[Message]) -> str:
    """The schema name of a message class: `zarm.Plan.v1`."""
    return f"zarm.{model.__name__}.v1"


def encode(message: Message) -> bytes:
    """A message as compact UTF-8 JSON."""
    return message.model_dump_json(exclude_none=True).encode()


def decode(model: type[M], payload: bytes) -> M:
    """Read a message; no payload at all reads as `{}`. Raises InvalidRequest that names the first field at fault."""
    if len(payload) > model.max_bytes:
        raise InvalidRequest(
            f"the payload of {len(payload)} bytes is over the limit of {model.max_bytes} for {model.__name__}; send less at "
            "once",
            field="payload",
        )
    if payload.count(b":") > MAX_FIELDS:
        raise InvalidRequest(
            f"the payload has more than {MAX_FIELDS} fields; send less at once, or a {model.__name__}", field="payload"
        )
    payload = payload or b"{}"
    try:
        return model.model_validate_json(payload)
    except ValidationError as error:
        first = error.errors(include_url=False, include_input=False)[0]
        path = field_path(first["loc"], json.loads(payload) if first["loc"] and _tagged(payload) else None)
        more = f"; and {error.error_count() - 1} more" if error.error_count() > 1 else ""
        raise InvalidRequest(
            f"{model.__name__}: {sentence(first['msg'])}{more}", field=".".join(map(str, path)) or None
        ) from error


def _tagged(payload: bytes) -> bool:
    """Whether the path of a fault may hold tags of a union; millions of values are not parsed again for nothing."""
    return any(f'"{tag}"'.encode() in payload for tag in TAGS)
