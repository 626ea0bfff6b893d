"""How kernels are compiled, and where the result is kept."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar, cast

import numba

F = TypeVar("F", bound=Callable[..., Any])

config = cast(Any, numba.config)


def _cache_folder() -> str:
    # Numba notices a change in a kernel's own file, not in the files of the kernels that it calls, and would then run
    # the old ones. A folder named after the content of all of them cannot hold an old one.
    here = Path(__file__).parent
    content = b"".join(path.read_bytes() for path in sorted(here.glob("*.py")))
    root = Path(config.CACHE_DIR or here / "__pycache__")
    return str(root / f"kernels-{hashlib.sha256(content).hexdigest()[:16]}")


config.CACHE_DIR = _cache_folder()


def kernel(function: F) -> F:
    """Compile on the first call, or load what an earlier process compiled; runs without the GIL.

    Honours NUMBA_CACHE_DIR; otherwise the cache lies in `__pycache__`, or in the user's cache where that is read-only.
    """
    return cast(F, numba.njit(cache=True, nogil=True, error_model="numpy")(function))


def brief(function: F) -> F:
    """Like `kernel`, for a few microseconds of work: it keeps the GIL, for to hand it over would take longer than that."""
    return cast(F, numba.njit(cache=True, error_model="numpy")(function))


def inlined(function: F) -> F:
    """Like `kernel`, for a part of one: compiled into its callers, which saves the reference counts of its arrays."""
    return cast(F, numba.njit(forceinline=True, error_model="numpy")(function))
