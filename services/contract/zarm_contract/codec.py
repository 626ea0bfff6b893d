"""Messages to bytes and back: JSON, with the schema `zarm.<Message>.v1` as encoding."""

from __future__ import annotations

import json
from typing import TypeVar

from pydantic import ValidationError

from zarm_contract._faults import field_path, sentence
from zarm_contract._model import Message
from zarm_contract.errors import InvalidRequest

M = TypeVar("M", bound=Message)

MAX_BYTES = 8 * 1024 * 1024
"""Largest payload that is read: some 20,000 samples of a trajectory of 7 joints, three minutes at 100 Hz."""


def schema(model: type[Message]) -> str:
    """The schema name of a message class: `zarm.Plan.v1`."""
    return f"zarm.{model.__name__}.v1"


def encode(message: Message) -> bytes:
    """A message as compact UTF-8 JSON."""
    return message.model_dump_json(exclude_none=True).encode()


def decode(model: type[M], payload: bytes) -> M:
    """Read a message; no payload at all reads as `{}`. Raises InvalidRequest that names the first field at fault."""
    if len(payload) > MAX_BYTES:
        raise InvalidRequest(
            f"the payload of {len(payload)} bytes is over the limit of {MAX_BYTES}; send less at once", field="payload"
        )
    payload = payload or b"{}"
    try:
        return model.model_validate_json(payload)
    except ValidationError as error:
        first = error.errors(include_url=False, include_input=False)[0]
        path = field_path(first["loc"], json.loads(payload)) if first["loc"] else ()
        more = f"; and {error.error_count() - 1} more" if error.error_count() > 1 else ""
        raise InvalidRequest(
            f"{model.__name__}: {sentence(first['msg'])}{more}", field=".".join(map(str, path)) or None
        ) from error
