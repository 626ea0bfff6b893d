"""Joins equal boxes of cells that lie side by side."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from zarm_geometry.kernels.compiled import kernel

Codes = NDArray[np.int64]


@kernel
def joined(first: Codes, last: Codes, step: int) -> tuple[Codes, Codes]:
    """Boxes by the codes of their first and last cells (n,), each joined with the one before it along an axis if that is
    as large in the other two.

    A code increases by `step` from cell to cell along that axis, along which each box is one cell thick. The codes
    `first` ascend, before and after.
    """
    box, starts, ends = np.empty_like(first), np.empty_like(first), np.empty_like(last)
    count = before = 0
    for i in range(len(first)):
        while first[before] < first[i] - step:
            before += 1
        if first[before] == first[i] - step and last[before] == last[i] - step:
            box[i] = box[before]
        else:
            box[i] = count
            starts[count] = first[i]
            count += 1
        ends[box[i]] = last[i]
    return starts[:count], ends[:count]
