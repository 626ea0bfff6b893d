"""TOPPRA without matplotlib, which it imports only for plots."""

from __future__ import annotations

import logging
import sys
from functools import cache
from types import ModuleType

import numpy as np
from numpy.typing import NDArray

_PLOTS = [name for name in ("matplotlib", "matplotlib.pyplot") if name not in sys.modules]
sys.modules.update({name: ModuleType(name) for name in _PLOTS})

from toppra import SplineInterpolator, solverwrapper  # noqa: E402
from toppra.algorithm import TOPPRA  # noqa: E402
from toppra.constraint import JointAccelerationConstraint, JointVelocityConstraint  # noqa: E402

for _name in _PLOTS:  # so that later imports load the real modules
    del sys.modules[_name]
solverwrapper.available_solvers = cache(solverwrapper.available_solvers)  # looking for packages takes 0.5 ms
logging.getLogger("toppra").setLevel(logging.CRITICAL)


class CappedVelocityConstraint(JointVelocityConstraint):  # type: ignore[misc]
    """A joint velocity constraint that also keeps the path's own velocity below `cap` (n,) at the grid points."""

    def __init__(self, velocity: NDArray[np.float64], cap: NDArray[np.float64]) -> None:
        super().__init__(velocity)
        self._cap = cap

    def _assert_valid_limits(self) -> None:
        """Limits come from a valid descriptor; TOPPRA would also describe each in words, which takes 1 ms."""

    def compute_constraint_params(self, path: object, gridpoints: NDArray[np.float64]) -> tuple[object, ...]:
        """The constraint at the grid points, in TOPPRA's form; the last of them bounds the square of the velocity."""
        *others, bound = super().compute_constraint_params(path, gridpoints)
        bound[:, 1] = np.minimum(bound[:, 1], self._cap**2)
        return *others, bound


__all__ = [
    "TOPPRA",
    "CappedVelocityConstraint",
    "JointAccelerationConstraint",
    "JointVelocityConstraint",
    "SplineInterpolator",
]
