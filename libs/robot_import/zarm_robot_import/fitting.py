"""Exact geometry and sphere covers of all links, and how far each protrudes from the meshes."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from zarm_contract.collision import CollisionPrimitive
from zarm_robot_import.body import Body
from zarm_robot_import.decomposition import fit_primitives
from zarm_robot_import.meshes import Surface
from zarm_robot_import.primitives import packed_shapes_of
from zarm_robot_import.protrusion import Measure, Out
from zarm_robot_import.spheres import ball_rows, fit_covers
from zarm_trajectory.arrays import Array


@dataclass(frozen=True)
class Fitted:
    """The exact geometry of a link, also as rows (n, 17) of `zarm_geometry.packed_shapes`, and the balls (k, 4) of its cover.

    The primitives contain the link's surface, and the cover contains them; `exact_out` and `cover_out` say how far they
    protrude.
    """

    link: str
    primitives: list[CollisionPrimitive]
    rows: Array
    balls: Array
    exact_out: Out
    cover_out: Out


def fit(
    surfaces: Sequence[Surface], budget: int, carried: Mapping[str, int], done: Callable[[str], None]
) -> list[Fitted]:
    """Fit all links, with at most `budget` balls in all covers, more of them where more joints carry a link, as
    `carried` says; `done` is called with each link whose exact geometry is ready.
    """
    bodies = {surface.link: Body.of(*surface.shells.values(), off=surface.off) for surface in surfaces}
    primitives: dict[str, list[CollisionPrimitive]] = {}
    for link, body in bodies.items():
        primitives[link] = fit_primitives(body)
        done(link)
    rows = {link: packed_shapes_of(each) for link, each in primitives.items()}
    covers = fit_covers(rows, carried, budget)
    found = []
    for link, body in bodies.items():
        measure = Measure(body)
        outs = (measure.all(table) for table in (rows[link], ball_rows(covers[link])))
        found.append(Fitted(link, primitives[link], rows[link], covers[link], *outs))
    return found
