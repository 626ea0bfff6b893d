"""Joint vectors in kernels, element by element: for a slice assignment numba also compiles its error messages, which
takes seconds.
"""

from __future__ import annotations

import math
from typing import Any

from numpy.typing import NDArray

from zarm_geometry.kernels.compiled import inlined
from zarm_trajectory.arrays import Single


@inlined
def copy(source: NDArray[Any], target: NDArray[Any]) -> None:
    """Copy a vector."""
    for k in range(source.shape[0]):
        target[k] = source[k]


@inlined
def between(a: Single, b: Single, part: float, out: Single) -> None:
    """Write to `out` the point at the fraction `part` (0..1) of the way from `a` to `b`; `out` may be one of them."""
    for k in range(a.shape[0]):
        out[k] = a[k] + (b[k] - a[k]) * part


@inlined
def apart(a: Single, b: Single) -> float:
    """Euclidean distance."""
    total = 0.0
    for k in range(a.shape[0]):
        total += (a[k] - b[k]) ** 2
    return math.sqrt(total)
