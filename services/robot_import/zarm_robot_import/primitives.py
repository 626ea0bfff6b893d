"""Exact geometry of a link: a few tight convex primitives that contain its surface.

A link is cut by planes, as in convex decomposition (Mamou and Ghorbel, "A simple and efficient approach for 3D mesh
approximate convex decomposition", 2009), and each cell is enclosed by the smallest box, cylinder, capsule or ball. The
one that protrudes most is cut next, where that leaves the least volume. A convex primitive contains a piece of surface
if it contains the corners of its triangles, so containment is exact: triangles are cut at the same planes.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from itertools import combinations
from typing import NamedTuple, Self

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError, cKDTree
from scipy.spatial.transform import Rotation

from zarm_contract.robot import (
    CollisionCapsule,
    CollisionCuboid,
    CollisionCylinder,
    CollisionPrimitive,
    CollisionSphere,
)
from zarm_geometry.frames import rotation_to
from zarm_geometry.shapes import link_shape
from zarm_robot_import.body import FAR, Body
from zarm_robot_import.kernels.enclosing import around, oriented
from zarm_robot_import.kernels.middles import middles
from zarm_robot_import.kernels.outside import least_outside, within
from zarm_robot_import.meshes import areas, points_on

Array = NDArray[np.float64]

MEAN, MOST = 0.004, 0.012
"""A link whose primitives protrude (m) by no more than this on average, and at most, is not cut further ..."""
COUNT = 130
"""... nor one with this many primitives."""
_ROUNDS = 3
"""A link with so many is cut further once those that can be are merged, at most so many times."""
_POINTS = 250
"""Points that represent the surface in the search for planes."""
_SAMPLES = 400
"""Points on each primitive used to measure how far it protrudes."""
_EVERY = 10
"""One of so many of them is measured first."""
_CUTS = 5
"""Planes tried along each axis."""
_FEWEST = 25
"""Least number of points on each side of a plane."""
_SAME = math.cos(math.radians(1.0))
"""Axes whose angle has a larger cosine count as the same."""
_TOUCHING = 0.001
"""Boxes this close (m) to each other touch."""
_ORDERS = ([1, 2, 0], [2, 0, 1], [0, 1, 2])
_FLAT = 0.002
"""All volume counts as if it were at least this far (m) outside, because thin shapes fit between the body's points."""


def written(row: Array) -> CollisionPrimitive:
    """A row (17,) of `zarm_geometry.rows` in the descriptor's form."""
    frame = row[:12].reshape(3, 4)
    turn = frame[:, :3].T
    middle = -turn @ frame[:, 3]
    core, disc, rounding = row[12:15], round(float(row[15]), 7), round(float(row[16]), 7)
    if not disc and not rounding:
        x, y, z, w = np.round(Rotation.from_matrix(turn).as_quat(canonical=True), 9).tolist()
        return CollisionCuboid(
            kind="cuboid", center=_numbers(middle), orientation=(x, y, z, w), size=_numbers(2 * core)
        )
    if not core[2]:
        return CollisionSphere(center=_numbers(middle), radius=rounding)
    a, b = (_numbers(middle + end * core[2] * turn[:, 2]) for end in (-1.0, 1.0))
    if disc:
        return CollisionCylinder(kind="cylinder", a=a, b=b, radius=disc)
    return CollisionCapsule(kind="capsule", a=a, b=b, radius=rounding)


def rows_of(primitives: Sequence[CollisionPrimitive]) -> Array:
    """The primitives of a link as rows (n, 17) in its frame, see `zarm_geometry.rows`."""
    found = []
    for shape in (link_shape("", primitive) for primitive in primitives):
        turn = shape.pose[:3, :3].T
        frame = np.column_stack((turn, -turn @ shape.pose[:3, 3]))
        found.append(np.concatenate([frame.ravel(), shape.core, [shape.disc, shape.rounding]]))
    return np.array(found).reshape(-1, 17)


def triangles_of(row: Array) -> Array:
    """The surface (n, 3, 3) of a primitive (17,), in its link's frame, to 1 % of its radius."""
    core, disc, rounding = row[12:15], row[15], row[16]
    if disc:
        placed = _cylinder() * (disc, disc, core[2])
    elif rounding:
        placed = _capsule() * rounding
        placed[..., 2] += np.where(placed[..., 2] > 0.0, core[2] - rounding, rounding - core[2])
    else:
        placed = _box() * core
    frame = row[:12].reshape(3, 4)
    found: Array = (placed - frame[:, 3]) @ frame[:, :3]
    return found


@cache
def _cylinder() -> Array:
    """The surface (n, 3, 3) of a cylinder of radius 1 and length 2."""
    return np.array(trimesh.creation.cylinder(1.0, 2.0, sections=48).triangles)


@cache
def _capsule() -> Array:
    """The surface (n, 3, 3) of a capsule of radius 1 whose ends are 2 apart."""
    mesh = trimesh.creation.capsule(2.0, 1.0, count=[24, 24])
    return np.array(mesh.triangles - mesh.bounds.mean(axis=0))


@cache
def _box() -> Array:
    """The surface (n, 3, 3) of a cube of size 2."""
    return np.array(trimesh.creation.box((2.0, 2.0, 2.0)).triangles)


@dataclass(eq=False)
class _Cell:
    """The content between planes: triangles (n, 3, 3), their distinct vertices (j, 3), the corners (k, 3) of their convex
    hull, points (m, 3) on them, and the row of the enclosing primitive; `out` as in `_tightest`.

    `axes` (l, 3, 3) are the frames to try here. `final` if no plane makes it tighter.
    """

    triangles: Array
    vertices: Array
    corners: Array
    points: Array
    axes: Array
    row: Array
    out: float
    final: bool = False

    @cached_property
    def box(self) -> tuple[list[float], list[float]]:
        """The lower and upper corner (3,) of the box around it."""
        return self.corners.min(axis=0).tolist(), self.corners.max(axis=0).tolist()


def fit_primitives(body: Body) -> list[CollisionPrimitive]:
    """Primitives that contain all triangles of a link's surface."""
    axes = _axes(body.surface.data, body.triangles, np.empty((0, 3, 3)))
    measure = Measure(body)
    cells = [_piece(body.triangles, body.corners, axes, body)]
    for _ in range(_ROUNDS):
        cut = _cut(cells, axes, body, measure)
        cells = _merged(cut, axes, body, measure)
        if len(cut) < COUNT or len(cells) == COUNT:
            break
    return [written(cell.row) for cell in cells]


def _cut(cells: list[_Cell], axes: Array, body: Body, measure: Measure) -> list[_Cell]:
    """The cells, cut until they protrude no more than wanted or are `COUNT`."""
    outs: dict[_Cell, Out] = {}
    while len(cells) < COUNT:
        _add_missing(outs, cells, measure)
        worth = {cell: out.most for cell, out in outs.items()}
        if max(worth.values()) <= MOST:
            worth = {cell: out.total for cell, out in outs.items()}
            if Out.together(list(outs.values())).mean <= MEAN:
                break
        left = [cell for cell in cells if not cell.final]
        if not left:
            break
        worst = max(left, key=lambda cell: worth[cell])
        halves = _halves(worst, axes, body, measure.outside(worst.row))
        if halves:
            cells = [cell for cell in cells if cell is not worst] + halves
            outs = {cell: out for cell, out in outs.items() if not _adjoin(cell, worst)}
        else:
            worst.final = True
    return cells


def _merged(cells: list[_Cell], axes: Array, body: Body, measure: Measure) -> list[_Cell]:
    """The cells, merged where the result protrudes no more than wanted, or than the separate ones."""
    far = body.points[body.out & (body.distance > MOST)]
    far = far[~within(far, _rows(cells), 0.0)]  # and it stays outside

    def union_of(a: _Cell, b: _Cell) -> _Cell | None:
        union = _union(a, b, axes, body) if _adjoin(a, b) else None
        return None if union is None or within(far, union.row[None], 0.0).any() else union

    unions: dict[tuple[_Cell, _Cell], _Cell | None] = {}  # None if they should stay separate
    outs: dict[_Cell, Out] = {}
    while True:
        pairs = list(combinations(cells, 2))
        for pair in pairs:
            if pair not in unions:
                unions[pair] = union_of(*pair)
        _add_missing(outs, cells, measure)
        now = Out.together(list(outs.values()))
        spare = max(MEAN * now.area, now.total) - now.total
        made = [(a, b, union) for a, b in pairs if (union := unions[a, b])]
        for a, b, union in sorted(made, key=lambda one: one[2].out - one[0].out - one[1].out):
            rest = [cell for cell in cells if cell not in (a, b)]
            most = max(MOST, outs[a].most, outs[b].most)
            out = measure.one(union.row, _rows(rest), most)
            if out.most <= most and out.total <= spare + outs[a].total + outs[b].total:
                cells = [*rest, union]
                outs = {cell: outs[cell] for cell in rest if not _adjoin(cell, union)}
                break
            unions[a, b] = None
        else:
            return cells


def _add_missing(outs: dict[_Cell, Out], cells: list[_Cell], measure: Measure) -> None:
    """Measure the cells that have not been measured since something near them changed."""
    for i, cell in enumerate(cells):
        if cell not in outs:
            outs[cell] = measure.one(cell.row, _rows(cells[:i] + cells[i + 1 :]))


def _rows(cells: Sequence[_Cell]) -> Array:
    return np.array([cell.row for cell in cells]).reshape(-1, 17)


@dataclass(frozen=True)
class Out:
    """How far (m) the outside of a primitive is from the body: at most, and integrated over its `area` (m^2)."""

    most: float
    total: float
    area: float

    @property
    def mean(self) -> float:
        """The mean distance (m)."""
        return self.total / self.area if self.area else 0.0

    @classmethod
    def together(cls, outs: Sequence[Self]) -> Self:
        """Several primitives combined."""
        return cls(max(out.most for out in outs), sum(out.total for out in outs), sum(out.area for out in outs))


class Measure:
    """How far primitives protrude from a body."""

    def __init__(self, body: Body) -> None:
        self._cloud = cKDTree(np.concatenate([points_on(body.triangles, 20_000)[0], body.corners]))
        self._body = body
        self._known: dict[bytes, _Skin] = {}

    def all(self, rows: Sequence[Array]) -> list[Out]:
        """For each primitive (17,), without the parts inside the body or another one."""
        return [self.one(row, np.array([*rows[:i], *rows[i + 1 :]]).reshape(-1, 17)) for i, row in enumerate(rows)]

    def one(self, row: Array, others: Array, most: float = np.inf) -> Out:
        """For one primitive (17,), without the parts inside the body or one of `others` (n, 17); sampled, so an upper
        bound. If it protrudes further than `most` (m), the answer says no more than that.
        """
        if row.tobytes() not in self._known and (far := self._few(row, others)) > most:
            return Out(far, 0.0, 0.0)
        skin = self._skin(row)
        outer = np.flatnonzero(~within(skin.points, others, 1e-5))
        # Whether a point is within the body takes the longest to tell: first of those that decide.
        self._tell(skin, outer[skin.out[outer] > most])
        if skin.out[outer].max(initial=0.0) <= most:
            self._tell(skin, outer)
        out = skin.out[outer]
        return Out(float(out.max(initial=0.0)), skin.each * float(out.sum()), skin.each * len(out))

    def _few(self, row: Array, others: Array) -> float:
        """How far (m) the farthest of a few of the points on a primitive protrudes: enough to reject most that protrude too far."""
        points = points_on(triangles_of(row), _SAMPLES)[0][::_EVERY]
        points = points[~within(points, others, 1e-5)]
        out = self._cloud.query(points)[0]
        unsure = out > MEAN
        return float(out[unsure][~self._body.inside(points[unsure])].max(initial=0.0))

    def _tell(self, skin: _Skin, some: NDArray[np.intp]) -> None:
        """Decide which of these points are within the body."""
        unsure = some[skin.unsure[some]]
        skin.out[unsure[self._body.inside(skin.points[unsure])]] = 0.0
        skin.unsure[unsure] = False

    def outside(self, row: Array) -> tuple[Array, Array]:
        """Points (n, 3) on a primitive (17,) outside the body, and for each the integral (n,) of the distance cost over
        the volume below it, in m^5: for thin primitives, which contain too few of the body's points.
        """
        self.one(row, np.empty((0, 17)))
        skin = self._skin(row)
        out = skin.out > 0.0
        depth = skin.out[out]
        return skin.points[out], skin.each * (depth**3 / 3 + depth**5 / (5 * FAR**2))

    def _skin(self, row: Array) -> _Skin:
        if (key := row.tobytes()) not in self._known:
            triangles = triangles_of(row)
            points = points_on(triangles, _SAMPLES)[0]
            out = self._cloud.query(points)[0]
            self._known[key] = _Skin(points, out, out > MEAN, float(areas(triangles).sum()) / len(points))
        return self._known[key]


@dataclass(frozen=True)
class _Skin:
    """Points (n, 3) on a primitive, their distances (n,) from the body, and a mask `unsure` (n,) of those that may be
    inside; each represents an area of `each` (m^2).
    """

    points: Array
    out: Array
    unsure: NDArray[np.bool_]
    each: float


def _axes(points: Array, triangles: Array, known: Array) -> Array:
    """The frames `known` (n, 3, 3) and more, with z along the directions in which planes and primitives are tried.

    They are the axes of the link, the principal ones of points (k, 3) on its surface, and those of its largest flat
    faces.
    """
    found = list(known[::3])
    main = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)[2].T
    main[:, 2] *= np.linalg.det(main)  # right-handed
    for triple in (*(() if found else (np.eye(3),)), main, _faces(triangles)):
        if not found or np.abs(triple.T @ np.concatenate(found, axis=1)).max(axis=1).min() < _SAME:
            found.append(triple)
    return np.array([triple[:, order] for triple in found for order in _ORDERS])


def _faces(triangles: Array) -> Array:
    """Axes (3, 3): the direction that most area faces, that of most area perpendicular to it, and their normal."""
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    sizes = np.linalg.norm(normals, axis=1)
    if not sizes.any():
        return np.eye(3)
    normals, sizes = normals[sizes > 0.0] / sizes[sizes > 0.0, None], sizes[sizes > 0.0]
    normals *= np.where(normals @ (1.0, 0.1, 0.01) < 0.0, -1.0, 1.0)[:, None]
    names, group = np.unique(np.round(normals, 2), axis=0, return_inverse=True)
    total = np.bincount(group, sizes, len(names))

    def largest(which: int) -> Array:
        found: Array = normals[np.argmax(np.where(group == which, sizes, 0.0))]
        return found

    first = largest(int(total.argmax()))
    across = total * (np.abs(names @ first) < 0.05)
    if not across.any():
        return rotation_to(first)
    second = np.cross(np.cross(first, largest(int(across.argmax()))), first)
    second /= np.linalg.norm(second)
    return np.column_stack((first, second, np.cross(first, second)))


def _piece(triangles: Array, vertices: Array, axes: Array, body: Body) -> _Cell:
    """A cell of some of the triangles, whose vertices are these."""
    corners = _hull(vertices)
    along = corners @ axes[:, :, 2].T
    furthest = np.unique(np.concatenate([along.argmin(axis=0), along.argmax(axis=0)]))
    points = np.concatenate([points_on(triangles, _POINTS)[0], corners[furthest]])
    return _cell(triangles, vertices, corners, points, _axes(points, triangles, axes), body)


def _union(a: _Cell, b: _Cell, axes: Array, body: Body) -> _Cell:
    """Two cells merged."""
    return _cell(
        np.concatenate([a.triangles, b.triangles]),
        np.concatenate([a.vertices, b.vertices]),
        np.concatenate([a.corners, b.corners]),
        np.concatenate([a.points[::2], b.points[::2]]),
        np.concatenate([a.axes, b.axes[len(axes) :]]),
        body,
    )


def _adjoin(a: _Cell, b: _Cell) -> bool:
    """Whether the boxes around two cells touch."""
    (low, high), (other_low, other_high) = a.box, b.box
    return all(low[i] <= other_high[i] + _TOUCHING and other_low[i] <= high[i] + _TOUCHING for i in range(3))


def _hull(points: Array) -> Array:
    """The corners (k, 3) of the convex hull of points (n, 3); all points if they are coplanar."""
    found: Array
    try:
        found = points[ConvexHull(points).vertices]
    except QhullError:
        found = np.unique(points, axis=0)
    return found


def _cell(triangles: Array, vertices: Array, corners: Array, points: Array, axes: Array, body: Body) -> _Cell:
    form = _form(points, axes)
    which, out = _tightest(points, form, body.around(points))
    one = [which % len(axes)]
    shapes = around(corners, form.turn[one], form.box[one], form.axis[one], form.middle)
    return _Cell(triangles, vertices, corners, points, axes, grown(shapes[which // len(axes)], body.off), out)


def grown(row: Array, by: float) -> Array:
    """A primitive (17,) that contains all points within `by` (m) of one without triangles."""
    row = row.copy()
    if row[16]:
        row[16] += by
    elif row[15]:
        row[14:16] += by
    else:
        row[12:15] += by
    return row


def _halves(cell: _Cell, axes: Array, body: Body, outside: tuple[Array, Array]) -> list[_Cell]:
    """A cell cut in two by the plane that leaves the least outside the body; empty if there is none.

    `outside` counts beside the body's points: points (n, 3) on the cell's primitive, and the cost (n,) of each.
    """
    best, chosen = np.inf, None
    points, weights = (np.concatenate(each) for each in zip(body.around(cell.points), outside, strict=True))
    order = np.argsort(-weights)
    near = points[order], weights[order]

    def left(axis: Array, offset: float) -> float:
        below = cell.points @ axis < offset
        if not _FEWEST <= np.count_nonzero(below) <= len(below) - _FEWEST:
            return np.inf
        out = 0.0
        for points in (cell.points[below], cell.points[~below]):
            out += _tightest(points, _form(points, cell.axes), near, best - out)[1]
            if out >= best:
                break
        return out

    for axis in cell.axes[:, :, 2]:
        along = cell.points @ axis
        low, high = float(along.min()), float(along.max())
        for offset in low + (high - low) * (np.arange(_CUTS) + 1) / (_CUTS + 1):
            if (out := left(axis, offset)) < best:
                best, chosen, step = out, (axis, float(offset)), (high - low) / (_CUTS + 1)
    if chosen is None:
        return []
    for _ in range(4):
        step /= 2
        axis, middle = chosen
        for offset in (middle - step, middle + step):
            if (out := left(axis, offset)) < best:
                best, chosen = out, (axis, offset)
    below, above, across = cut(cell.triangles, *chosen)
    high = cell.vertices @ chosen[0] > chosen[1]
    return [
        _piece(part, np.concatenate([vertices, across]), axes, body)
        for part, vertices in ((below, cell.vertices[~high]), (above, cell.vertices[high]))
        if len(part)
    ]


class _Form(NamedTuple):
    """The known part of primitives, without their sizes: frames (n, 3, 3) of round ones with z along them, and of
    boxes; a point (n, 3) on the axis; the centre (3,) of a ball.
    """

    turn: Array
    box: Array
    axis: Array
    middle: Array


def _form(points: Array, axes: Array) -> _Form:
    return _Form(axes, *oriented(points, axes), middles(points[None])[0])


def _tightest(points: Array, form: _Form, outer: tuple[Array, Array], most: float = np.inf) -> tuple[int, float]:
    """The primitive around points with the least cost outside the body: its index and cost; -1 and `most` if all cost
    more.

    `outer` are points outside, and the cost of each. The cost is the integral over the primitive of that of the
    distance to the body, in m^5.
    """
    rows = around(points, *form)
    return least_outside(rows, _FLAT**2 * _volumes(rows), *outer, most)


def _volumes(rows: Array) -> Array:
    """Volumes (n,) in m^3."""
    x, y, z, disc, rounding = rows[:, 12:].T
    found: Array = 8 * x * y * z + math.pi * (2 * disc**2 * z + rounding**2 * (2 * z + 4 / 3 * rounding))
    return found


def cut(triangles: Array, normal: Array, offset: float) -> tuple[Array, Array, Array]:
    """The triangles (n, 3, 3) below and above the plane of points x with normal * x = offset, cut where it intersects
    them, and the points (k, 3) of these cuts.
    """
    away = triangles @ normal - offset
    above = away > 0.0
    count = above.sum(axis=1)
    low, high = triangles[count == 0], triangles[count == 3]
    crossing = (count == 1) | (count == 2)
    some, heights, lone_above = triangles[crossing], away[crossing], count[crossing] == 1
    lone = np.argmax(above[crossing] == lone_above[:, None], axis=1)
    each = np.arange(len(some))
    turned = [(lone + k) % 3 for k in range(3)]
    a, b, c = (some[each, k] for k in turned)
    ha, hb, hc = (heights[each, k][:, None] for k in turned)
    ab, ac = a + (b - a) * (ha / (ha - hb)), a + (c - a) * (ha / (ha - hc))
    tip = np.stack((a, ab, ac), axis=1)
    rest = np.concatenate([np.stack((ab, b, c), axis=1), np.stack((ab, c, ac), axis=1)])
    twice = np.tile(lone_above, 2)
    return (
        np.concatenate([low, tip[~lone_above], rest[twice]]),
        np.concatenate([high, tip[lone_above], rest[~twice]]),
        np.concatenate([ab, ac]),
    )


def _numbers(values: Array) -> tuple[float, float, float]:
    x, y, z = (np.round(values, 7) + 0.0).tolist()
    return x, y, z
