"""How kernels are compiled, and where the compiled code is cached."""

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
"""NUMBA_CACHE_DIR as set by the user."""


def kernel(function: F) -> F:
    """Compile a function on its first call, or load what an earlier process compiled; it runs without the GIL.

    The cache is in `__pycache__` beside the function's file, or in the user's cache if that is read-only.
    NUMBA_CACHE_DIR overrides both; that folder starts as a copy of what was compiled into `__pycache__`. A copy is
    needed because numba only reads a cache that it can also write to: it recompiles entries that were made for another
    CPU.
    """
    return _cached(function, nogil=True)


def brief(function: F) -> F:
    """Like `kernel`, for a few microseconds of work: it keeps the GIL, since releasing it would take longer than the
    work.
    """
    return _cached(function, nogil=False)


def _cached(function: F, *, nogil: bool) -> F:
    # Numba reads the folder from its configuration when it decorates a function.
    config.CACHE_DIR = _cache_folder(Path(function.__code__.co_filename).parent)
    return cast(F, numba.njit(cache=True, nogil=nogil, error_model="numpy")(function))


@cache
def _cache_folder(kernels: Path) -> str:
    """The cache folder for the compiled files of the folder `kernels`."""
    # Numba notices a change in a kernel's own file, but not in the files of the kernels that it calls, and would run
    # outdated code. A folder named after the content of all these files never holds outdated code. Kernels call those
    # beside them and those of the geometry.
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
    # The copy appears atomically, even if other processes copy too or this one is killed: numba fails on partial files.
    with suppress(OSError):  # another process was faster, or the disk is full: numba then compiles by itself
        folder.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=folder.parent, prefix="new-") as new:
            shutil.copytree(source, Path(new, folder.name)).rename(folder)


def inlined(function: F) -> F:
    """Like `kernel`, for a function called by kernels: it is inlined into its callers, which saves reference counting
    of its arrays.
    """
    return cast(F, numba.njit(forceinline=True, error_model="numpy")(function))
