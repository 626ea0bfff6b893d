"""Exact geometry and sphere cover of all links of a robot, and how far each stands out of the meshes."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from zarm_contract.robot import CollisionPrimitive
from zarm_robot_import.body import Body
from zarm_robot_import.meshes import Surface
from zarm_robot_import.primitives import Measure, Out, fit_primitives, rows_of
from zarm_robot_import.spheres import Covers, ball_rows

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Fitted:
    """The exact geometry of a link, also as rows (n, 17) of `zarm_geometry.rows`, and the balls (k, 4) of its cover.

    The primitives contain the link's surface, and the cover contains them; `exact_out` and `cover_out` say how far they stand out.
    """

    link: str
    primitives: list[CollisionPrimitive]
    rows: Array
    balls: Array
    exact_out: Out
    cover_out: Out


class Fitting:
    """The exact geometry of all links, found once, for covers that may be found again."""

    def __init__(self, surfaces: Sequence[Surface], budget: int, done: Callable[[str], None]) -> None:
        """`budget` balls in all covers; `done` is told each link whose exact geometry is found."""
        self._bodies = {surface.link: Body.of(surface.triangles) for surface in surfaces}
        self._primitives: dict[str, list[CollisionPrimitive]] = {}
        for link, body in self._bodies.items():
            self._primitives[link] = fit_primitives(body)
            done(link)
        self._rows = {link: rows_of(primitives) for link, primitives in self._primitives.items()}
        self._covers = Covers(self._rows, budget)

    def links(self, share: Mapping[str, float] | None = None) -> list[Fitted]:
        """All links; the cover of one stands out by `share` (0..1) of what others do, of 1 where that is not given."""
        covers = self._covers.fitted(dict.fromkeys(self._bodies, 1.0) | dict(share or {}))
        found = []
        for link, body in self._bodies.items():
            measure = Measure(body)
            rows, balls = self._rows[link], covers[link]
            outs = (Out.together(measure.all(list(table))) for table in (rows, ball_rows(balls)))
            found.append(Fitted(link, self._primitives[link], rows, balls, *outs))
        return found
