"""Trajectories that keep a path constraint: a smooth curve on its manifold, timed."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from zarm_planner.constraints.path_constraint import ConstraintManifold
from zarm_planner.deadline import Deadline
from zarm_planner.timing.time_parameterization import through, time_curve
from zarm_trajectory.arrays import Array
from zarm_trajectory.limits import Limits
from zarm_trajectory.trajectory import TimedTrajectory

_SPACING = 0.1
"""Initial spacing (rad) of the points that define the curve."""
_ROUNDS = 5
"""How often the curve may be brought closer to the path, each time with half the point spacing."""
_ON_MANIFOLD = 2
"""In this many rounds the points are projected onto the manifold; after that they stay on the steps of the path."""
_LOOKS = 4
"""Samples checked per interval between two points of the curve."""
_RANGE = 8e-5
"""Rad or m by which a curve may exceed the joint ranges; slightly less than `verify` allows."""
_LARGEST_USE = 0.9
"""The share of the tolerances that the curve may use."""


def time_constrained(
    constraint: ConstraintManifold,
    path: Array,
    limits: Limits,
    dt: float,
    *,
    free: Callable[[Array], bool],
    deadline: Deadline,
    vias: Sequence[int] = (),
) -> TimedTrajectory | None:
    """A fast motion along a smooth curve through points of `path` (n, dof), sampled every `dt` s or less.

    The rows `vias` are among these points, so the motion passes them exactly. Where configurations (n, dof) along the
    curve are not `free`, or break the constraint, the points are moved closer together. None if that does not help, or
    at `deadline`.

    Raises InvalidRequest if the limits make the motion longer than `trajectory.MAX_SAMPLES`.
    """
    length = np.insert(np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1)), 0, 0.0)
    if length[-1] < 1e-6:
        return TimedTrajectory.standing(path[0], dt)
    allowed = max(_LARGEST_USE, float(constraint.use(path[[0, -1]]).max()))
    for halved in range(_ROUNDS):
        if deadline.passed:
            return None
        at, fixed = _along(length[[0, *vias, len(path) - 1]], _SPACING / 2**halved)
        points = np.stack([np.interp(at, length, joint) for joint in path.T], axis=1)
        # Points projected onto the manifold may collide although the straight step is free, so the final rounds keep
        # to the steps themselves.
        if halved < _ON_MANIFOLD and (near := constraint.projected(points[~fixed])) is not None:
            points[~fixed] = near
        curve = through(points)
        looks = np.linspace(0.0, curve.duration, _LOOKS * len(points))
        rows, _, _ = curve.sample(looks)
        if (
            np.all(np.maximum(constraint.model.lower - rows, rows - constraint.model.upper) <= _RANGE)
            and constraint.use(rows).max() <= allowed
            and free(rows)
        ):
            return time_curve(curve, limits, dt)
    return None


def _along(knots: Array, spacing: float) -> tuple[Array, NDArray[np.bool_]]:
    """Lengths (n,) along a path, at most `spacing` apart and at least three per stretch between `knots` (k,), which are
    included; and a mask (n,) of the knots.
    """
    at, fixed = [knots[:1]], [np.ones(1, np.bool_)]
    for a, b in itertools.pairwise(knots):
        count = max(3, math.ceil((b - a) / spacing)) if b > a else 0
        at.append(np.linspace(a, b, count + 1)[1:])
        fixed.append(np.arange(count) == count - 1)
    return np.concatenate(at), np.concatenate(fixed)
