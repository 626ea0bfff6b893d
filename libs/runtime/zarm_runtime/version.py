"""The version of zarm."""

from __future__ import annotations

import importlib.metadata


def version() -> str:
    """The installed version of zarm."""
    return importlib.metadata.version("zarm")
