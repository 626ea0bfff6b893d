"""The smooth curve of the joints along which the tip follows a curve of poses."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple, Self

import numpy as np
from scipy.interpolate import CubicSpline

from zarm_planner.cartesian.curve import ToolCurve
from zarm_trajectory.arrays import Array

PROGRESS = 3
"""Columns that a motion along a curve has besides the joints: the curve's parameter, the tip's way (m), its turn (rad)."""
_PARTS_PER_INTERVAL = 4
"""Parts of each interval between stations by which lengths are measured."""


class JointSection(NamedTuple):
    """The `spline` through the joints and PROGRESS more columns in `rows` (n, dof + PROGRESS) at the `stations` (n,) between two rests."""

    stations: Array
    rows: Array
    spline: CubicSpline


@dataclass(frozen=True)
class JointCurve:
    """The curve of `dof` joints, section by section."""

    dof: int
    sections: tuple[JointSection, ...]

    @classmethod
    def of(cls, curve: ToolCurve, path: Array) -> Self:
        """The curve in joint space through `path` (n, dof), the configurations at the samples of the tool's curve."""
        measured = _measured(curve)
        sections = []
        for first, last in curve.sections:
            stations = curve.stations[first : last + 1]
            rows = np.column_stack((path[first : last + 1], stations, measured[first : last + 1]))
            sections.append(JointSection(stations, rows, CubicSpline(stations, rows)))
        return cls(path.shape[1], tuple(sections))


def _measured(curve: ToolCurve) -> Array:
    """How far the tip has moved (m) and turned (rad) at each station: (n, 2)."""
    count = len(curve.stations)
    fine = np.interp(
        np.arange((count - 1) * _PARTS_PER_INTERVAL + 1) / _PARTS_PER_INTERVAL, np.arange(count), curve.stations
    )
    position, turned = curve.at(fine)
    moved = np.linalg.norm(np.diff(position, axis=0), axis=1)
    # The difference of two rotations that are an angle t apart has the Frobenius norm 2 sqrt(2) sin(t / 2).
    turns = 2.0 * np.arcsin(np.linalg.norm(np.diff(turned, axis=0), axis=(1, 2)) / 8.0**0.5)
    total = np.insert(np.cumsum(np.column_stack((moved, turns)), axis=0), 0, 0.0, axis=0)
    return np.asarray(total[::_PARTS_PER_INTERVAL])
