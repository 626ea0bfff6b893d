"""Whether a body can have an inertia tensor."""

from __future__ import annotations

import numpy as np

from zarm_trajectory.arrays import Array

_ROUNDING = 1e-3
"""Part of the largest principal moment by which the rounded numbers of a URDF may be off."""


def unphysical(inertia: Array | None) -> bool:
    """Whether no body has this inertia tensor (3, 3): a principal moment is negative, or larger than the other two
    together.
    """
    if inertia is None:
        return False
    moments = np.linalg.eigvalsh(inertia)
    slack = _ROUNDING * abs(float(moments[-1]))
    return bool(moments[0] < -slack or moments[-1] > moments[0] + moments[1] + slack)
