"""The version of zarm."""

from __future__ import annotations

import importlib.metadata
from functools import cache


@cache
def version() -> str:
    """The installed version of zarm."""
    return importlib.metadata.version("zarm")
