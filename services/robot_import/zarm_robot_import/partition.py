"""The cells that a link is cut into, and how far each protrudes from it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from zarm_robot_import.cells import Cell, adjoin
from zarm_robot_import.protrusion import Measure, Out

Array = NDArray[np.float64]


class Partition:
    """Cells, and for each the part `outs` of its primitive that is neither inside the body nor inside another one.

    After a replacement only those nearby are measured again.
    """

    def __init__(self, cells: Sequence[Cell], measure: Measure) -> None:
        self.outs: dict[Cell, Out] = {}
        self.measure = measure
        self.cells: list[Cell] = []
        self.replace((), cells)

    def replace(self, old: Sequence[Cell], new: Sequence[Cell]) -> None:
        """Put some cells in the place of others."""
        self.cells = [*self.others(*old), *new]
        near = (*old, *new)
        kept = {
            cell: out
            for cell, out in self.outs.items()
            if cell not in old and not any(adjoin(cell, one) for one in near)
        }
        self.outs = {
            cell: kept[cell] if cell in kept else self.measure.one(cell.row, self.rows(cell)) for cell in self.cells
        }

    def others(self, *cells: Cell) -> list[Cell]:
        """All cells but some."""
        return [cell for cell in self.cells if cell not in cells]

    def rows(self, *but: Cell) -> Array:
        """The primitives (n, 17) of all cells but some."""
        return np.array([cell.row for cell in self.others(*but)]).reshape(-1, 17)

    def out(self) -> Out:
        """How far all of them protrude."""
        return Out.together(list(self.outs.values()))
