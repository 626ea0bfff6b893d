"""The cells that a link is cut into, and how far each protrudes from it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from zarm_robot_import.cells import Cell, touch
from zarm_robot_import.protrusion import Measure, Out
from zarm_trajectory.arrays import Array


class Partition:
    """Cells, and for each the part `outs` of its primitive that is neither inside the body nor inside another one.

    Primitives `beside` (n, 17) are there besides those of the cells.
    """

    def __init__(
        self, cells: Sequence[Cell], measure: Measure, beside: Array, known: Mapping[Cell, Out] | None = None
    ) -> None:
        self.cells = list(cells)
        self.measure = measure
        self.beside = beside
        known = known or {}
        self.outs = {
            cell: known[cell] if cell in known else measure.one(cell.row, self.rows(cell)) for cell in self.cells
        }

    def replaced(self, old: Sequence[Cell], new: Sequence[Cell]) -> Partition:
        """Some cells replaced by others; only those whose primitives are near are measured again."""
        near = [cell.extent for cell in (*old, *new)]
        known = {cell: out for cell, out in self.outs.items() if not any(touch(cell.extent, one) for one in near)}
        return Partition([*(cell for cell in self.cells if cell not in old), *new], self.measure, self.beside, known)

    def rows(self, *but: Cell) -> Array:
        """All primitives (n, 17) but those of some cells."""
        return np.array([*self.beside, *(cell.row for cell in self.cells if cell not in but)]).reshape(-1, 17)

    def out(self) -> Out:
        """How far all cells protrude."""
        return Out.together(list(self.outs.values()))

    def excess(self) -> float:
        """By how many times the wanted distance they protrude."""
        return self.measure.goal.excess(self.out())
