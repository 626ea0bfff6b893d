"""Whole turns of continuous joints: angles that differ by them are the same."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from zarm_trajectory.arrays import Array

TURN = 2.0 * math.pi


def whole_turns(angle: Array, continuous: Sequence[bool] | NDArray[np.bool_]) -> Array:
    """The whole turns, in rad, nearest to each `angle` (..., J) in rad; 0 for joints that are not `continuous` (J,).

    So `q + whole_turns(near - q, continuous)` is what is equivalent to `q` and nearest to `near`.
    """
    return np.where(continuous, TURN * np.round(angle / TURN), 0.0)
