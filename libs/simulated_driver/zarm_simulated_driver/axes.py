"""The joints in the driver's order: by index in commands, reordered in joint states."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np
import numpy.typing as npt

from zarm_contract.descriptor import RobotDescriptor

HUMBLE_ORDER = (0, 1, 3, 4, 2, 5)
"""The order in which ROS 2 Humble reports the M1013's joints: 1, 2, 4, 5, 3, 6."""


@dataclass(frozen=True)
class Axes:
    """J joints: their `names` by index, and the order in which their indices are reported."""

    names: tuple[str, ...]
    order: tuple[int, ...]

    @classmethod
    def of(cls, descriptor: RobotDescriptor) -> Self:
        """Those of the driver that `descriptor` describes."""
        params = descriptor.strategy_params
        names = (None if params is None else params.joint_order) or descriptor.joints
        return cls(names, HUMBLE_ORDER if len(names) == len(HUMBLE_ORDER) else tuple(range(len(names))))

    @property
    def reported_joints(self) -> tuple[str, ...]:
        """The names in the order in which they are reported."""
        return tuple(self.names[index] for index in self.order)

    def as_reported(self, values: npt.NDArray[np.float64]) -> tuple[float, ...]:
        """Values (J,), given by index, in the order of `reported_joints`."""
        return tuple(values[list(self.order)].tolist())
