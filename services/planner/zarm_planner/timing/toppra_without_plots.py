"""TOPPRA without matplotlib, which it imports only for plots."""

from __future__ import annotations

import logging
import sys
from functools import cache
from types import ModuleType

_PLOTS = [name for name in ("matplotlib", "matplotlib.pyplot") if name not in sys.modules]
sys.modules.update({name: ModuleType(name) for name in _PLOTS})

from toppra import SplineInterpolator, solverwrapper  # noqa: E402
from toppra.algorithm import TOPPRA  # noqa: E402
from toppra.constraint import JointAccelerationConstraint, JointVelocityConstraint  # noqa: E402

for _name in _PLOTS:  # so that later imports load the real modules
    del sys.modules[_name]
solverwrapper.available_solvers = cache(solverwrapper.available_solvers)  # looking for packages takes 0.5 ms
logging.getLogger("toppra").setLevel(logging.CRITICAL)

__all__ = ["TOPPRA", "JointAccelerationConstraint", "JointVelocityConstraint", "SplineInterpolator"]
