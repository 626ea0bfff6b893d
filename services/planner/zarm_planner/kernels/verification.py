"""Comparisons of a trajectory with what it must keep."""

from __future__ import annotations

from zarm_geometry.kernels.compiled import brief, inlined
from zarm_trajectory.arrays import Array


@inlined
def _alike(one: Array, other: Array, tolerance: float) -> bool:
    """Whether no value (dof,) differs by more than `tolerance`, or is NaN."""
    alike = True
    for j in range(one.shape[0]):
        alike = alike and abs(one[j] - other[j]) <= tolerance
    return alike


@brief
def first_missed(
    position: Array, velocity: Array, acceleration: Array, start: Array, goal: Array, motion: Array, tolerance: float
) -> int:
    """The first condition at the ends of a trajectory (n, dof) that is missed by more than `tolerance`; -1 if none is.

    0 and 1: the positions `start` and `goal` (dof,); 2 and 3: the velocity and acceleration `motion` (2, dof) at the
    start; 4: rest at the end.
    """
    still = 0.0 * goal
    if not _alike(position[0], start, tolerance):
        return 0
    if not _alike(position[-1], goal, tolerance):
        return 1
    if not _alike(velocity[0], motion[0], tolerance):
        return 2
    if not _alike(acceleration[0], motion[1], tolerance):
        return 3
    return -1 if _alike(velocity[-1], still, tolerance) else 4


@brief
def furthest_outside(position: Array, lower: Array, upper: Array) -> tuple[float, int, int]:
    """How far positions (n, dof) get outside the range from `lower` to `upper` (dof,), negative if they stay inside;
    at which sample, and which joint. NaN counts as furthest.
    """
    most, sample, joint = -1e300, 0, 0
    for i in range(position.shape[0]):
        for j in range(position.shape[1]):
            outside = max(lower[j] - position[i, j], position[i, j] - upper[j])
            if not outside <= most:
                most, sample, joint = outside, i, j
                if outside != outside:
                    return most, sample, joint
    return most, sample, joint
