"""The base class of every message, exported as `zarm_contract.messages.Message`."""

from __future__ import annotations

from typing import Any, ClassVar

from pydantic import BaseModel, ConfigDict, GetCoreSchemaHandler


def _fail_fast(schema: Any) -> None:
    """Make every sequence in a pydantic schema fail at its first fault (pydantic's `FailFast`)."""
    if isinstance(schema, dict):
        if schema.get("type") == "tuple" and "variadic_item_index" in schema:
            schema["fail_fast"] = True
        for part in schema.values():
            _fail_fast(part)
    elif isinstance(schema, list):
        for part in schema:
            _fail_fast(part)


class Message(BaseModel):
    """Strict, frozen, without unknown fields, without NaN and infinity; at most `max_bytes` long.

    Reading stops at the first fault of a row of values: to list a million of them would hold up the process for seconds.
    """

    max_bytes: ClassVar[int] = 8 * 1024 * 1024
    """Some 20,000 samples of a trajectory of 7 joints, three minutes at 100 Hz."""
    any_contract: ClassVar[bool] = False
    """Whether messages from other versions of the contract are accepted too."""

    model_config = ConfigDict(
        strict=True,
        extra="forbid",
        frozen=True,
        allow_inf_nan=False,
        defer_build=True,  # a short command needs few of them; `codec.build_all` builds the rest
    )

    @classmethod
    def __get_pydantic_core_schema__(cls, source: Any, handler: GetCoreSchemaHandler) -> Any:
        schema = handler(source)
        _fail_fast(schema)
        return schema


class ShortMessage(Message):
    """What a control loop reads, or a robot must be stopped by: so short that to refuse it takes no time either."""

    max_bytes: ClassVar[int] = 16 * 1024
    """Four times a joint state of 32 joints with long names."""
