"""The base of everything on the wire; to others it is `zarm_contract.messages.Message`."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict


class Message(BaseModel):
    """Strict, frozen, without unknown fields, without NaN and infinity."""

    model_config = ConfigDict(
        strict=True,
        extra="forbid",
        frozen=True,
        allow_inf_nan=False,
    )
