"""Triangles of polygons, strips and fans. A polygon of n corners becomes n - 2 triangles on those corners, no more and no less, so
that neighbours which share an edge still share it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from zarm_geometry.mesh_files.mesh_file import Unreadable
from zarm_trajectory.arrays import Array, Indices

MOST_CORNERS = 2000
"""Most corners of a polygon that is not convex: cutting it takes time with the square of their number."""
_EPSILON = 1e-12
"""Twice the area, relative to the polygon's, below which a triangle has none."""


def triangulated(points: Array, sizes: Indices, corners: Indices) -> Indices:
    """Triangles (m, 3), as indices into `points` (n, 3), of polygons with so many corners each (k,), wound like them;
    `corners` (sum of sizes,) are indices into `points`. Polygons of fewer than 3 corners give none.
    """
    starts = np.cumsum(sizes) - sizes
    found = [np.empty((0, 3), np.int64)]
    for size in np.unique(sizes[sizes >= 3]):
        here = starts[sizes == size]
        found.append(_alike(points, corners[here[:, None] + np.arange(size)]))
    return np.concatenate(found)


def with_holes(points: Array, outline: Indices, holes: Sequence[Indices]) -> Indices:
    """Triangles of one polygon with holes: each hole is joined to the outline by an edge that is walked twice, so there are
    two triangles more than corners for each, less 2.
    """
    every = np.concatenate([outline, *holes])
    if len(every) > MOST_CORNERS:
        raise Unreadable(
            f"a polygon with holes has {len(every)} corners, more than {MOST_CORNERS}; export it as triangles"
        )
    normal = _normal(points[outline][None])[0]
    flat = dict(zip(every.tolist(), _projected(points[every], normal), strict=True))
    ring = outline.tolist()
    left = [_turned(hole.tolist(), flat) for hole in holes]
    left.sort(key=lambda hole: -max(flat[i][0] for i in hole))
    for number, hole in enumerate(left):
        walls = [(a, b) for loop in (ring, *left[number:]) for a, b in zip(loop, loop[1:] + loop[:1], strict=True)]
        at = max(range(len(hole)), key=lambda i: flat[hole[i]][0])
        start = flat[hole[at]]
        near = sorted(range(len(ring)), key=lambda i: float(np.hypot(*(flat[ring[i]] - start))))
        bridge = next((i for i in near if _sees(start, ring, i, flat, walls)), None)
        if bridge is None:
            raise Unreadable("a hole of a polygon lies outside of it, or crosses it; export it as triangles")
        ring = [*ring[: bridge + 1], *hole[at:], *hole[: at + 1], *ring[bridge:]]
    return np.array(_cut(np.array([flat[i] for i in ring]), ring), np.int64)


def strip(corners: Indices) -> Indices:
    """Triangles (n - 2, 3) of a strip: every second one is wound the other way, so it is turned."""
    found = np.column_stack([corners[:-2], corners[1:-1], corners[2:]])
    found[1::2, :2] = found[1::2, 1::-1]
    return found


def fan(corners: Indices) -> Indices:
    """Triangles (n - 2, 3) around the first corner."""
    return np.column_stack([np.broadcast_to(corners[:1], max(0, len(corners) - 2)), corners[1:-1], corners[2:]])


def _alike(points: Array, polygons: Indices) -> Indices:
    """Triangles of polygons (k, n) with the same number of corners."""
    size = polygons.shape[1]
    if size == 3:
        return polygons
    places = points[polygons]
    fans = np.stack(
        [np.broadcast_to(polygons[:, :1], (len(polygons), size - 2)), polygons[:, 1:-1], polygons[:, 2:]], 2
    )
    with np.errstate(invalid="ignore", over="ignore"):
        normal = _normal(places)
        arms = places[:, 1:] - places[:, :1]
        turns = np.einsum("kni,ki->kn", np.cross(arms[:, :-1], arms[:, 1:]), normal)
        # The first corner sees the whole polygon if no triangle of its fan is turned over. Not finite: nothing to cut.
        plain = ~(turns < -_EPSILON * np.einsum("ki,ki->k", normal, normal)[:, None]).any(axis=1)
    plain |= ~np.isfinite(places).all(axis=(1, 2))
    found = [fans[plain].reshape(-1, 3)]
    if size > MOST_CORNERS and not plain.all():
        raise Unreadable(f"a polygon that is not convex has {size} corners, more than {MOST_CORNERS}; export triangles")
    for polygon, place, up in zip(polygons[~plain], places[~plain], normal[~plain], strict=True):
        found.append(np.array(_cut(_projected(place, up), polygon.tolist()), np.int64))
    return np.concatenate(found)


def _normal(places: Array) -> Array:
    """Normals (k, 3) of polygons (k, n, 3), with twice their area as length (Newell's method)."""
    arms = places[:, 1:] - places[:, :1]
    return np.asarray(np.cross(arms[:, :-1], arms[:, 1:]).sum(axis=1))


def _projected(places: Array, normal: Array) -> Array:
    """Places (n, 2) in the plane across a normal, counter-clockwise around it."""
    drop = int(np.argmax(np.abs(normal)))
    axes = [(1, 2), (2, 0), (0, 1)][drop]
    return np.asarray(places[:, axes if normal[drop] >= 0.0 else axes[::-1]])


def _cut(places: Array, names: list[int]) -> list[tuple[int, int, int]]:
    """The triangles of a polygon (n, 2), cut off one ear after another (Meisters, 1975)."""
    scale = max(float(np.ptp(places, axis=0).max()), 1e-300)
    places = (places - places[0]) / scale
    left, found = list(range(len(names))), []
    while len(left) > 3:
        at = _ear(places, left)
        found.append((left[at - 1], left[at], left[(at + 1) % len(left)]))
        del left[at]
    found.append((left[0], left[1], left[2]))
    return [(names[a], names[b], names[c]) for a, b, c in found]


def _ear(places: Array, left: list[int]) -> int:
    """Which corner of the polygon can be cut off."""
    here = places[left]
    before, after = np.roll(here, 1, axis=0), np.roll(here, -1, axis=0)
    turn = _cross(here - before, after - here)
    for at in np.flatnonzero(turn > _EPSILON):
        a, b, c = before[at], here[at], after[at]
        inside = (_cross(b - a, here - a) >= 0.0) & (_cross(c - b, here - b) >= 0.0) & (_cross(a - c, here - c) >= 0.0)
        same = (here == a).all(axis=1) | (here == b).all(axis=1) | (here == c).all(axis=1)
        if not (inside & ~same).any():
            return int(at)
    flat = np.flatnonzero(np.abs(turn) <= _EPSILON)
    if len(flat):
        return int(flat[0])
    raise Unreadable("a polygon crosses itself; export it as triangles")


def _cross(a: Array, b: Array) -> Array:
    return np.asarray(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])


def _turned(hole: list[int], flat: dict[int, Array]) -> list[int]:
    """A hole clockwise."""
    places = np.array([flat[i] for i in hole])
    return hole[::-1] if _cross(places, np.roll(places, -1, axis=0)).sum() > 0.0 else hole


def _sees(start: Array, ring: list[int], at: int, flat: dict[int, Array], walls: list[tuple[int, int]]) -> bool:
    """Whether nothing stands between a place and a corner of a ring, and the corner opens towards it."""
    end = flat[ring[at]]
    before, after = flat[ring[at - 1]], flat[ring[(at + 1) % len(ring)]]
    leaves = _cross(after - end, start - end) > 0.0, _cross(end - before, start - before) > 0.0
    opens = all(leaves) if _cross(end - before, after - end) > 0.0 else any(leaves)
    if not opens:
        return False
    a = np.array([flat[i] for i, _ in walls])
    b = np.array([flat[i] for _, i in walls])
    sides = _cross(end - start, a - start) * _cross(end - start, b - start)
    across = _cross(b - a, start - a) * _cross(b - a, end - a)
    touches = np.zeros(len(walls), bool)
    for one in (a, b):
        along = np.einsum("ni,i->n", one - start, end - start) / max(float((end - start) @ (end - start)), 1e-300)
        on = np.abs(_cross(end - start, one - start)) <= _EPSILON
        touches |= on & (along > 1e-9) & (along < 1.0 - 1e-9)
    return not bool((((sides < 0.0) & (across < 0.0)) | touches).any())
