"""Which inertias and efforts of a URDF can be used."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from zarm_contract.collision import CollisionPrimitive
from zarm_contract.robot import RobotDescription
from zarm_contract.urdf import Inertial
from zarm_trajectory.arrays import Array

_OUTSIDE = 0.05
"""How far outside of the box around its link a centre of mass may be (m): a link may have more than its geometry."""
_STANCES = 200
"""Random configurations at which an arm has to hold itself."""
_ROUNDING = 1e-3
"""Share by which the rounded numbers of a URDF may be off."""


def usable_inertials(robot: RobotDescription) -> tuple[dict[str, Inertial], list[str]]:
    """The inertials that a body in the place of the link's geometry can have, and what is wrong with the others."""
    usable: dict[str, Inertial] = {}
    faults: list[str] = []
    for link, inertial in robot.urdf.inertials.items():
        away = _outside(inertial.xyz, robot.descriptor.collision.get(link, ()))
        moments, axes = np.linalg.eigh(_tensor(inertial))
        largest = moments[0] + moments[1]
        if away > _OUTSIDE:
            faults.append(f"{link}: its centre of mass is {away:.2f} m outside of it, so that its inertial is not used")
        elif moments[0] <= 0.0:
            faults.append(
                f"{link}: it has a moment of inertia of {moments[0]:g} kg m², so that its inertial is not used"
            )
        elif moments[2] > (1.0 + _ROUNDING) * largest:
            faults.append(
                f"{link}: no body has the moments of inertia {moments[0]:.3g}, {moments[1]:.3g} and {moments[2]:.3g} kg m²; the "
                f"largest is taken as {largest:.3g}"
            )
            usable[link] = replace(inertial, inertia=_six(axes @ np.diag([*moments[:2], largest]) @ axes.T))
        else:
            usable[link] = inertial
    return usable, faults


def _tensor(inertial: Inertial) -> Array:
    xx, yy, zz, xy, xz, yz = inertial.inertia
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def _six(tensor: Array) -> tuple[float, float, float, float, float, float]:
    (xx, xy, xz), (_, yy, yz), (_, _, zz) = tensor.tolist()
    return xx, yy, zz, xy, xz, yz


def _outside(point: tuple[float, float, float], shapes: Iterable[CollisionPrimitive]) -> float:
    """How far a point is outside of the box around some shapes (m); 0 without shapes."""
    corners = [corner for shape in shapes for corner in _box(shape)]
    if not corners:
        return 0.0
    low, high = np.min(corners, axis=0), np.max(corners, axis=0)
    away = np.maximum(0.0, np.maximum(low - point, point - high))
    return float(np.linalg.norm(away))


def _box(shape: CollisionPrimitive) -> tuple[Array, Array]:
    if shape.kind == "cuboid":
        half = 0.5 * float(np.linalg.norm(shape.size))
        return np.array(shape.center) - half, np.array(shape.center) + half
    if shape.kind == "sphere":
        return np.array(shape.center) - shape.radius, np.array(shape.center) + shape.radius
    ends = np.array([shape.a, shape.b])
    return ends.min(axis=0) - shape.radius, ends.max(axis=0) + shape.radius


def stances(robot: RobotDescription) -> Array:
    """Configurations (n, dof) at which an arm has to hold itself: home, and others all over its range."""
    low, high = (np.array(each) for each in robot.range_about(robot.descriptor.home))
    others = np.random.default_rng(0).uniform(low, high, (_STANCES, len(low)))
    return np.concatenate([[robot.descriptor.home], others])


def stated_limits(robot: RobotDescription, holding: Array) -> Array:
    """The efforts (dof,) of the URDF; infinite where none is stated, or one that cannot bear `holding` (n, dof), what holds
    the empty arm at its `stances`.
    """
    efforts = {joint.name: joint.effort for joint in robot.urdf.joint_of_child.values()}
    stated = np.array([efforts[name] or 0.0 for name in robot.descriptor.joints])
    return np.where(stated > np.abs(holding).max(axis=0), stated, np.inf)
