"""The common base of the sections of a robot descriptor."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict


class Section(BaseModel):
    """Part of a file that is written by hand."""

    # Not strict: to YAML `1` is no float and `[...]` no tuple.
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)
