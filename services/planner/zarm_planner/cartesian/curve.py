"""The curve along which the tip moves: its pose as a function of a parameter, twice continuously differentiable."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation, RotationSpline

from zarm_contract.errors import InvalidRequest
from zarm_contract.messages import ArcGoal, CartesianGoal, LineGoal, PathGoal, PathPoint, Quaternion
from zarm_geometry.frames import rotated_by, rotation
from zarm_trajectory.arrays import Array, Indices

_POINT_TOLERANCE = 1e-6
"""m and rad: points that are nearer to each other than this are one."""
_BLEND = 0.01, 0.4
"""m, and share of the shorter line: where a corner is left unless the goal says otherwise."""
_BACK = -0.9995
"""Cosine of a turn that doubles back: less than 2 deg from half a turn."""
_SPACING = 0.01, math.radians(2.0)
"""m and rad between two stations."""
_MIN_INTERVALS = 12
"""Least intervals between stations on a line or an arc."""
_CORNER = 8
"""Most intervals between stations in a corner; a slight one has fewer."""
_CORNER_ERROR = 1e-4, math.radians(0.1), 0.005
"""m and rad by which the legs of a corner differ for each of its intervals; m of a line that has one interval only."""
_TRANSPORT = 2000
"""Steps in which an orientation follows the tangent of a spline."""


class _Poses(Protocol):
    """Positions (n, 3) and orientations (n, 3, 3) at parameters (n,)."""

    def __call__(self, u: Array) -> tuple[Array, Array]: ...


@dataclass(frozen=True)
class ToolCurve:
    """A curve of poses in the base frame, from 0 to `end`; the tip rests at `rests`, both ends included.

    `stations` are parameters at which it is solved. `speed` (m/s), `acceleration` (m/s^2) and `rotational_speed` (rad/s)
    bound the motion along it. The parameter grows by `speed` per second while the tip moves, or turns, as fast as it may.
    """

    at: _Poses
    rests: tuple[float, ...]
    stations: Array
    speed: float
    acceleration: float
    rotational_speed: float

    @property
    def sections(self) -> tuple[tuple[int, int], ...]:
        """The first and last station of each part between two rests."""
        at = np.searchsorted(self.stations, np.array(self.rests) - 1e-9).tolist()
        return tuple(itertools.pairwise(at))

    def poses(self, u: Array) -> Array:
        """The poses (n, 4, 4) at parameters (n,)."""
        out = np.zeros((len(u), 4, 4))
        out[:, 3, 3] = 1.0
        out[:, :3, 3], out[:, :3, :3] = self.at(u)
        return out

    def refined(self) -> ToolCurve:
        """The same curve with a station between any two."""
        between = (self.stations[1:] + self.stations[:-1]) / 2.0
        return ToolCurve(
            self.at,
            self.rests,
            np.sort(np.concatenate((self.stations, between))),
            self.speed,
            self.acceleration,
            self.rotational_speed,
        )


@dataclass(frozen=True)
class _Speeds:
    speed: float
    acceleration: float
    rotational_speed: float

    def extent(self, length: float, angle: float) -> float:
        """The parameter that a stretch of `length` m and `angle` rad takes."""
        return max(length, angle * self.speed / self.rotational_speed)


def tool_curve(goal: CartesianGoal, start: Array, speeds: tuple[float, float, float], field: str) -> ToolCurve:
    """The curve of a goal, from the pose `start` (4, 4) of the tip; `speeds` are the default speed, acceleration and
    rotational speed.

    Raises InvalidRequest that names the field for a curve without extent, an arc through collinear points, corners
    larger than their lines, and a path that doubles back.
    """
    used = _Speeds(goal.speed or speeds[0], goal.acceleration or speeds[1], goal.rotational_speed or speeds[2])
    begin = start[:3, :3]
    if isinstance(goal, LineGoal):
        return _line(goal, start[:3, 3], begin, used, field)
    if isinstance(goal, ArcGoal):
        return _arc(goal, start[:3, 3], begin, used, field)
    return _path(goal, start[:3, 3], begin, used, field)


def _oriented(goal: CartesianGoal, begin: Array, asked: Quaternion | None) -> Array:
    """The orientation (3, 3) at a point, for `interpolated` and `fixed`."""
    return begin if asked is None or goal.orienting == "fixed" else rotation(asked)


def _turn(begin: Array, end: Array) -> Array:
    """The rotation vector (3,) from one orientation (3, 3) to another."""
    return np.zeros(3) if end is begin else np.asarray(Rotation.from_matrix(begin.T @ end).as_rotvec())


def _stations(extent: float, length: float, angle: float) -> Array:
    count = max(_MIN_INTERVALS, math.ceil(length / _SPACING[0]), math.ceil(angle / _SPACING[1]))
    return np.linspace(0.0, extent, count + 1)


def _line(goal: LineGoal, a: Array, begin: Array, speeds: _Speeds, field: str) -> ToolCurve:
    b = np.array(goal.position)
    turn = np.zeros(3) if goal.orienting == "tangent" else _turn(begin, _oriented(goal, begin, goal.orientation))
    length, angle = float(np.linalg.norm(b - a)), float(np.linalg.norm(turn))
    _has_extent(length, angle, field)
    extent = speeds.extent(length, angle)

    def at(u: Array) -> tuple[Array, Array]:
        share = (u / extent)[:, None]
        return a + share * (b - a), begin @ rotated_by(share * turn)

    return ToolCurve(at, (0.0, extent), _stations(extent, length, angle), *_values(speeds))


def _arc(goal: ArcGoal, a: Array, begin: Array, speeds: _Speeds, field: str) -> ToolCurve:
    b = np.array(goal.position)
    center, normal, sweep = _around(goal, a, b, field)
    x = a - center
    y = np.cross(normal, x)
    turn = _turn(begin, _oriented(goal, begin, goal.orientation))
    length, angle = sweep * float(np.linalg.norm(x)), float(np.linalg.norm(turn))
    if goal.orienting == "tangent":
        angle = sweep
    extent = speeds.extent(length, angle)

    def at(u: Array) -> tuple[Array, Array]:
        share = (u / extent)[:, None]
        phi = sweep * share
        position = center + np.cos(phi) * x + np.sin(phi) * y
        if goal.orienting == "tangent":
            return position, rotated_by(phi * normal) @ begin
        return position, begin @ rotated_by(share * turn)

    return ToolCurve(at, (0.0, extent), _stations(extent, length, max(angle, sweep)), *_values(speeds))


def _around(goal: ArcGoal | PathPoint, a: Array, b: Array, field: str) -> tuple[Array, Array, float]:
    """The centre (3,), the unit normal (3,) and the angle (rad) of an arc from `a` to `b` (3,)."""
    if float(np.linalg.norm(b - a)) < _POINT_TOLERANCE:
        return _full_circle(goal, a, field)
    if (goal.via is None) == (goal.center is None):
        raise InvalidRequest(
            "an arc needs either via, a point on it, or center; give one of them", field=f"{field}.via"
        )
    if goal.via is not None:
        via = np.array(goal.via)
        p, q = via - a, b - a
        normal = np.cross(p, q)
        square = float(normal @ normal)
        widest = max(float(p @ p), float(q @ q))
        if square < (1e-4 * widest) ** 2 or widest < _POINT_TOLERANCE**2:
            raise InvalidRequest(
                "the start, via and position lie on a line, and no arc leads through them; move via aside, or ask for a line",
                field=f"{field}.via",
            )
        center = a + np.cross((p @ p) * q - (q @ q) * p, normal) / (2.0 * square)
        normal = normal / math.sqrt(square)
        sweep = _angle(a - center, b - center, normal)
        return center, normal, sweep
    center = np.array(goal.center)
    p, q = a - center, b - center
    _same_radius(p, q, "position", field)
    normal = np.cross(p, q)
    if np.linalg.norm(normal) < 1e-4 * float(p @ p):
        raise InvalidRequest(
            "the start, center and position lie on a line, so that they do not say in which plane the arc is; give via",
            field=f"{field}.center",
        )
    normal /= np.linalg.norm(normal)
    return center, normal, _angle(p, q, normal)


def _full_circle(goal: ArcGoal | PathPoint, a: Array, field: str) -> tuple[Array, Array, float]:
    """The centre (3,), the unit normal (3,) and the angle (rad) of a circle from `a` (3,) by `via` back to it."""
    if goal.via is None or goal.center is None:
        raise InvalidRequest(
            "an arc that ends where it starts is a full circle; give both its center and via, another point on it",
            field=f"{field}.via" if goal.via is None else f"{field}.center",
        )
    center = np.array(goal.center)
    p, q = a - center, np.array(goal.via) - center
    _same_radius(p, q, "via", field)
    normal = np.cross(p, q)
    size = float(np.linalg.norm(normal))
    if size < 1e-4 * float(p @ p):
        raise InvalidRequest(
            "the start, center and via lie on a line, so that they do not say in which plane the circle is; move via on the circle",
            field=f"{field}.via",
        )
    return center, normal / size, 2.0 * math.pi


def _same_radius(p: Array, q: Array, other: str, field: str) -> None:
    """Raises InvalidRequest unless `p` and `q` (3,), from the centre to the start and to the `other` point, are as long."""
    radii = float(np.linalg.norm(p)), float(np.linalg.norm(q))
    if abs(radii[0] - radii[1]) > 1e-4 or min(radii) < _POINT_TOLERANCE:
        raise InvalidRequest(
            f"the center is {1e3 * radii[0]:.2f} mm from the start and {1e3 * radii[1]:.2f} mm from {other}; it is as far from "
            "both on an arc",
            field=f"{field}.center",
        )


def _angle(p: Array, q: Array, normal: Array) -> float:
    """The angle (0..2 pi) from `p` to `q` about `normal` (3,)."""
    return math.atan2(float(np.cross(p, q) @ normal), float(p @ q)) % (2.0 * math.pi)


def _path(goal: PathGoal, a: Array, begin: Array, speeds: _Speeds, field: str) -> ToolCurve:
    points, oriented, names, blends = [a], [begin], ["start"], [goal.blend]
    ways: list[PathPoint] = []
    for number, point in enumerate(goal.points):
        there = np.array(point.position)
        turned = _oriented(goal, oriented[-1], point.orientation)
        curved = point.via is not None or point.center is not None
        if curved and goal.shape == "spline":
            raise InvalidRequest(
                "a spline has no arcs; leave via and center out, or choose the shape polyline",
                field=f"{field}.points.{number}",
            )
        near = (
            not curved and float(np.linalg.norm(there - points[-1])) < _POINT_TOLERANCE
        )  # a circle ends where it starts
        near = near and float(np.linalg.norm(_turn(oriented[-1], turned))) < _POINT_TOLERANCE
        if near and number == 0:  # a path that names its start
            continue
        if near:
            raise InvalidRequest("this point is the one before it; leave it out", field=f"{field}.points.{number}")
        points.append(there)
        ways.append(point)
        oriented.append(turned)
        names.append(f"points.{number}")
        blends.append(goal.blend if point.blend is None else point.blend)
    if len(points) < 2:
        raise InvalidRequest("the path has no extent: it only names its start; add points", field=f"{field}.points")
    orientations = Rotation.from_matrix(np.array(oriented))
    if goal.shape == "spline":
        return _spline(goal, np.array(points), orientations, speeds)
    corners = _Corners(np.array(points), blends, [f"{field}.{name}" for name in names], field)
    return _polyline(goal, corners, _Ways.of(corners, ways), orientations, speeds)


def _spline(goal: PathGoal, points: Array, oriented: Rotation, speeds: _Speeds) -> ToolCurve:
    lengths = np.linalg.norm(np.diff(points, axis=0), axis=1).tolist()
    angles = (oriented[:-1].inv() * oriented[1:]).magnitude().tolist()
    steps = [speeds.extent(length, angle) for length, angle in zip(lengths, angles, strict=True)]
    knots = np.insert(np.cumsum(steps), 0, 0.0)
    end = float(knots[-1])
    curve = CubicSpline(knots, points)
    begin = oriented[0].as_matrix()
    turned: RotationSpline | None = None
    if goal.orienting == "tangent":
        fine = np.linspace(0.0, end, _TRANSPORT + 1)
        turned = RotationSpline(fine, _transported(oriented[0], curve(fine, 1)))
    elif any(angles):
        turned = RotationSpline(knots, oriented)

    def at(u: Array) -> tuple[Array, Array]:
        return curve(u), np.broadcast_to(begin, (len(u), 3, 3)) if turned is None else turned(u).as_matrix()

    counts = [
        max(4, math.ceil(length / _SPACING[0]), math.ceil(angle / _SPACING[1]))
        for length, angle in zip(lengths, angles, strict=True)
    ]
    return ToolCurve(at, (0.0, end), _divided(knots, counts), *_values(speeds))


def _transported(begin: Rotation, tangents: Array) -> Rotation:
    """The orientation `begin` carried along tangents (n, 3), each time by the smallest rotation between them."""
    steps = _smallest_turns(_unit(tangents))
    turned = [begin]
    for step in steps:
        turned.append(step * turned[-1])
    return Rotation.concatenate(turned)


def _smallest_turns(along: Array) -> Rotation:
    """The smallest rotations between consecutive directions (n, 3)."""
    axes = np.cross(along[:-1], along[1:])
    sines = np.linalg.norm(axes, axis=1, keepdims=True)
    angles = np.arctan2(sines, np.sum(along[:-1] * along[1:], axis=1, keepdims=True))
    return Rotation.from_rotvec(axes * np.where(sines > 1e-12, angles / np.maximum(sines, 1e-12), 1.0))


@dataclass(frozen=True)
class _Corners:
    """The `points` (n, 3) of a polyline, how far (m) each may be left, None for the default, and their fields in the request."""

    points: Array
    blends: Sequence[float | None]
    names: Sequence[str]
    field: str


@dataclass(frozen=True)
class _Ways:
    """The lines and arcs (n) between the points of a path.

    Over a share `u` of one, the tip moves by `u * along + (cos(u * sweep) - 1) * x + sin(u * sweep) * y`, all (n, 3), about `normal`; `along`
    is 0 for an arc, and the others for a line.
    """

    along: Array
    x: Array
    y: Array
    normal: Array
    sweep: Array

    @classmethod
    def of(cls, corners: _Corners, points: Sequence[PathPoint]) -> _Ways:
        """Those that lead to each of these points. Raises InvalidRequest for an arc that is none."""
        along = np.diff(corners.points, axis=0)
        sweep = np.zeros(len(along))
        x, y, normal = (np.zeros((len(along), 3)) for _ in range(3))
        for i, (point, name) in enumerate(zip(points, corners.names[1:], strict=True)):
            if point.via is not None or point.center is not None:
                center, normal[i], sweep[i] = _around(point, corners.points[i], corners.points[i + 1], name)
                along[i] = 0.0
                x[i] = corners.points[i] - center
                y[i] = np.cross(normal[i], x[i])
        return cls(along, x, y, normal, sweep)

    @property
    def lengths(self) -> Array:
        """Their lengths (n,) in m."""
        return np.asarray(np.linalg.norm(self.along, axis=1) + self.sweep * np.linalg.norm(self.x, axis=1))

    def moved(self, i: Indices, share: Array) -> Array:
        """How far (m, 3) the tip has moved over shares (m,) of the ways `i` (m,)."""
        angle = (share * self.sweep[i])[:, None]
        return np.asarray(
            share[:, None] * self.along[i] + (np.cos(angle) - 1.0) * self.x[i] + np.sin(angle) * self.y[i]
        )

    def rate(self, share: float) -> Array:
        """The derivatives (n, 3) of that by the share."""
        angle = (share * self.sweep)[:, None]
        return np.asarray(self.along + self.sweep[:, None] * (np.cos(angle) * self.y - np.sin(angle) * self.x))


def _polyline(goal: PathGoal, corners: _Corners, ways: _Ways, oriented: Rotation, speeds: _Speeds) -> ToolCurve:
    points, lengths = corners.points, ways.lengths
    if goal.orienting == "tangent":
        from_turns, vectors = _along_ways(corners, ways, oriented[0])
    else:
        from_turns = oriented[:-1]
        vectors = (from_turns.inv() * oriented[1:]).as_rotvec()
    angles = np.linalg.norm(vectors, axis=1)
    steps = np.array([speeds.extent(length, angle) for length, angle in zip(lengths, angles, strict=True)])
    knots = np.insert(np.cumsum(steps), 0, 0.0)
    half = _rounding(corners, ways, steps)
    matrices = from_turns.as_matrix()
    spin = vectors / steps[:, None]

    ends = matrices @ rotated_by(vectors)
    aside = np.zeros((len(points), 3))  # what the tip turns at each corner besides what its ways turn it
    aside[1:-1] = Rotation.from_matrix(ends[:-1].transpose(0, 2, 1) @ matrices[1:]).as_rotvec()

    def at(u: Array) -> tuple[Array, Array]:
        number = np.clip(np.searchsorted(knots, u, side="right") - 1, 0, len(steps) - 1)
        past = u - knots[number]
        position = np.asarray(points[number] + ways.moved(number, past / steps[number]))
        turned = matrices[number] @ rotated_by(past[:, None] * spin[number])
        corner = number + (past > steps[number] / 2.0)  # the nearer end of the way
        rounded = np.flatnonzero(np.abs(u - knots[corner]) < half[corner])
        if len(rounded):
            c = corner[rounded]
            x = (u[rounded] - knots[c]) / half[c] / 2.0 + 0.5
            before, after = (2.0 * half[c] * _ramp(each) for each in (1.0 - x, x))
            to_corner = ways.moved(c - 1, np.ones(len(c))) - ways.moved(c - 1, 1.0 - before / steps[c - 1])
            position[rounded] = points[c] - to_corner + ways.moved(c, after / steps[c])
            share = (x**3 * (10.0 + x * (6.0 * x - 15.0)))[:, None]
            turned[rounded] = (
                ends[c - 1]
                @ rotated_by(-before[:, None] * spin[c - 1])
                @ rotated_by(share * aside[c])
                @ rotated_by(after[:, None] * spin[c])
            )
        return position, turned

    arriving, leaving = ways.rate(1.0) / steps[:, None], ways.rate(0.0) / steps[:, None]
    bends = np.maximum(angles, ways.sweep)
    rests = [0.0, *knots[1:-1][half[1:-1] <= 0.0].tolist(), float(knots[-1])]
    edges, counts = [0.0], []
    for i, (length, angle) in enumerate(zip(lengths.tolist(), bends.tolist(), strict=True)):
        inner = knots[i] + half[i], knots[i + 1] - half[i + 1]
        if half[i] > 0.0:
            edges.append(inner[0])
            legs = half[i] * np.array((arriving[i - 1], leaving[i]))
            curved = half[i] * float((ways.sweep[i - 1 : i + 1] / steps[i - 1 : i + 1]).sum())
            counts.append(max(_corner_intervals(legs, spin[i - 1 : i + 1] * half[i]), math.ceil(curved / _SPACING[1])))
        straight = max((inner[1] - inner[0]) / steps[i], 0.0)
        if straight > 1e-9:
            few = _MIN_INTERVALS if len(steps) == 1 else 1 if straight * length < _CORNER_ERROR[2] else 2
            edges.append(inner[1])
            counts.append(
                max(few, math.ceil(straight * length / _SPACING[0]), math.ceil(straight * angle / _SPACING[1]))
            )
    return ToolCurve(at, tuple(rests), _divided(np.array(edges), counts), *_values(speeds))


def _ramp(x: Array) -> Array:
    """The integral of the smooth step x^3 (10 - 15 x + 6 x^2) from 0 on: 0 at 0, and 1/2 with a slope of 1 at 1.

    In a corner, the way along the line before it ends as this, and that along the line after it begins so: twice
    continuously differentiable, and inside the corner.
    """
    return np.asarray(x**4 * (2.5 + x * (x - 3.0)))


def _corner_intervals(legs: Array, turns: Array) -> int:
    """Into how many intervals a corner is divided, from the two legs (2, 3) in m and turns (2, 3) in rad that it joins."""
    bend = float(np.linalg.norm(legs[1] - legs[0])), float(np.linalg.norm(turns[1] - turns[0]))
    return int(np.clip(math.ceil(max(bend[0] / _CORNER_ERROR[0], bend[1] / _CORNER_ERROR[1])), 2, _CORNER))


def _along_ways(corners: _Corners, ways: _Ways, begin: Rotation) -> tuple[Rotation, Array]:
    """The orientation with which the tip begins each way and turns with it, and by what rotation vectors (n, 3) it turns on it.

    Raises InvalidRequest if the tip would have to turn on the spot.
    """
    lengths = ways.lengths
    if len(lengths) > 1 and (0.0 in corners.blends[1:-1] or lengths.min() < _POINT_TOLERANCE):
        raise InvalidRequest(
            "with the tangent the tip would turn on the spot at a corner; allow a blend", field=f"{corners.field}.blend"
        )
    leaving, arriving = (_unit(ways.rate(share)) for share in (0.0, 1.0))
    turned, vectors = [begin], []
    for i in range(len(lengths)):
        vectors.append(turned[i].inv().apply(ways.sweep[i] * ways.normal[i]))
        if i + 1 < len(lengths):
            corner = _smallest_turns(np.array((arriving[i], leaving[i + 1])))[0]
            turned.append(corner * turned[i] * Rotation.from_rotvec(vectors[i]))
    return Rotation.concatenate(turned), np.array(vectors)


def _unit(vectors: Array) -> Array:
    """Vectors (n, 3) of length 1."""
    return np.asarray(vectors / np.linalg.norm(vectors, axis=1, keepdims=True))


def _rounding(corners: _Corners, ways: _Ways, steps: Array) -> Array:
    """How far (n,) before and after each point its corner is rounded, in the curve's parameter; 0 at both ends.

    Raises InvalidRequest that names the point.
    """
    points, half, lengths = corners.points, np.zeros(len(corners.points)), ways.lengths
    leaving, arriving = ways.rate(0.0), ways.rate(1.0)
    for i in range(1, len(points) - 1):
        before, after, blend = lengths[i - 1], lengths[i], corners.blends[i]
        if min(before, after) < _POINT_TOLERANCE:  # the tip turns on the spot
            half[i] = 0.0 if blend == 0.0 else _BLEND[1] * min(steps[i - 1], steps[i])
            continue
        distance = min(_BLEND[0], _BLEND[1] * min(before, after)) if blend is None else blend
        if distance == 0.0:
            continue
        cosine = float(arriving[i - 1] @ leaving[i]) / (before * after)
        if cosine < _BACK:
            raise InvalidRequest(
                "the path doubles back here; set blend to 0, so that the tip comes to rest, or end the path here",
                field=corners.names[i],
            )
        half[i] = distance * min(steps[i - 1] / before, steps[i] / after)
    for i in range(len(points) - 1):
        if half[i] + half[i + 1] > steps[i] * (1.0 + 1e-9):
            largest = 1e3 * max(blend or 0.0 for blend in corners.blends[i : i + 2])
            raise InvalidRequest(
                f"a blend of {largest:.1f} mm does not fit on the line of {1e3 * lengths[i]:.1f} mm to "
                f"{corners.names[i + 1]}; lower blend, or leave out a point",
                field=f"{corners.field}.blend",
            )
    return half


def _divided(edges: Array, counts: Sequence[int]) -> Array:
    """Stations at the edges (n + 1,), with each of the n intervals between them divided into so many."""
    number = np.insert(np.cumsum(counts), 0, 0)
    return np.interp(np.arange(number[-1] + 1), number, edges)


def _values(speeds: _Speeds) -> tuple[float, float, float]:
    return speeds.speed, speeds.acceleration, speeds.rotational_speed


def _has_extent(length: float, angle: float, field: str) -> None:
    if length < _POINT_TOLERANCE and angle < _POINT_TOLERANCE:
        raise InvalidRequest(
            "the line has no extent: the tip is there already; choose another point", field=f"{field}.position"
        )
