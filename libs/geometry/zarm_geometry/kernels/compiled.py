"""How kernels are compiled, and where the result is kept."""

from __future__ import annotations

import hashlib
import shutil
import tempfile
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any, TypeVar, cast

import numba

F = TypeVar("F", bound=Callable[..., Any])

config = cast(Any, numba.config)

_CHOSEN = config.CACHE_DIR
"""NUMBA_CACHE_DIR."""


def kernel(function: F) -> F:
    """Compile on the first call, or load what an earlier process compiled; runs without the GIL.

    The cache lies in `__pycache__` beside the function's file, or in the user's cache where that is read-only. With
    NUMBA_CACHE_DIR it lies there, and begins as a copy of what was compiled into `__pycache__`: numba only reads a cache that
    it can write, since it may be one of another CPU, for which it compiles anew.
    """
    return _cached(function, nogil=True)


def brief(function: F) -> F:
    """Like `kernel`, for a few microseconds of work: it keeps the GIL, for to hand it over would take longer than that."""
    return _cached(function, nogil=False)


def _cached(function: F, *, nogil: bool) -> F:
    # Numba takes the folder from its configuration as it is now.
    config.CACHE_DIR = _cache_folder(Path(function.__code__.co_filename).parent)
    return cast(F, numba.njit(cache=True, nogil=nogil, error_model="numpy")(function))


@cache
def _cache_folder(kernels: Path) -> str:
    """Where the compiled form of the files in the folder `kernels` is kept."""
    # Numba notices a change in a kernel's own file, not in the files of the kernels that it calls, and would then run
    # the old ones. A folder named after the content of all of them cannot hold an old one. Kernels call those beside
    # them and those of the geometry.
    files = sorted({*kernels.glob("*.py"), *Path(__file__).parent.glob("*.py")})
    content = b"".join(path.read_bytes() for path in files)
    name = f"kernels-{hashlib.sha256(content).hexdigest()[:16]}"
    beside = kernels / "__pycache__" / name
    if not _CHOSEN:
        return str(beside)
    folder = Path(_CHOSEN) / name
    if beside.is_dir() and not folder.exists():
        _copy(beside, folder)
    return str(folder)


def _copy(source: Path, folder: Path) -> None:
    # Whole or not at all, whoever else does the same or kills this process meanwhile: numba would trip over half a file.
    with suppress(OSError):  # another process was faster, or there is no room: numba goes on by itself
        folder.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=folder.parent, prefix="new-") as new:
            shutil.copytree(source, Path(new, folder.name)).rename(folder)


def inlined(function: F) -> F:
    """Like `kernel`, for a part of one: compiled into its callers, which saves the reference counts of its arrays."""
    return cast(F, numba.njit(forceinline=True, error_model="numpy")(function))
