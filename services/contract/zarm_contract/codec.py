"""Messages to bytes and back: JSON, with the schema `zarm.<Message>.v1` as encoding."""

from __future__ import annotations

from typing import TypeVar

from pydantic import ValidationError

from zarm_contract._model import Message
from zarm_contract.errors import InvalidRequest

M = TypeVar("M", bound=Message)

MAX_BYTES = 8 * 1024 * 1024
"""Largest payload that is read: a minute of trajectory at 1 kHz for 7 joints is under it."""


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
    try:
        return model.model_validate_json(payload or b"{}")
    except ValidationError as error:
        first = error.errors(include_url=False, include_input=False)[0]
        field = ".".join(str(part) for part in first["loc"]) or None
        more = f"; and {error.error_count() - 1} more" if error.error_count() > 1 else ""
        raise InvalidRequest(f"{model.__name__}: {first['msg']}{more}", field=field) from error
