"""Deadlines in kernels."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
from numba import types
from numpy.typing import NDArray

from zarm_geometry.kernels.compiled import inlined
from zarm_geometry.kernels.simd import pointer

_gettime: Any = types.ExternalFunction("clock_gettime", types.int32(types.int32, types.CPointer(types.int64)))
_CLOCK = time.CLOCK_MONOTONIC


@inlined
def seconds(now: NDArray[np.int64]) -> float:
    """The monotonic clock (s); `now` (2,) is working memory. The call into the C library makes the compiler reload all
    values from memory.
    """
    _gettime(_CLOCK, pointer(now))
    return float(now[0] + 1e-9 * now[1])


@inlined
def passed(deadline: NDArray[np.float64], now: NDArray[np.int64]) -> bool:
    """Whether the monotonic clock is past `deadline[0]` (s), which another thread may change at any time.

    `now` (2,) is working memory. The call into the C library makes the compiler read `deadline` again each time.
    """
    return bool(seconds(now) > deadline[0])
