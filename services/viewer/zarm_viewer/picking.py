"""What a click in the 3D view hits.

The page asks here instead of making each drawing clickable: a clickable one would also catch the clicks on a gizmo that is inside it or
behind it, and the gizmo could not be dragged out again.
"""

from __future__ import annotations

import numpy as np
from viser import MeshHandle, PointCloudHandle, SceneNodeHandle

from zarm_trajectory.arrays import Array
from zarm_viewer.kinematics import pose_at


def distance(origin: Array, direction: Array, drawn: SceneNodeHandle) -> float:
    """How far along a ray, in the frame of its parent, a mesh or point cloud is hit: in m if `direction` (3,) is a unit
    vector, infinite if it is missed.
    """
    to_node = pose_at(drawn).inverse()
    start, way = (np.asarray(it, dtype=np.float64) for it in (to_node @ origin, to_node.rotation() @ direction))
    if isinstance(drawn, MeshHandle):
        return _triangles(start, way, np.asarray(drawn.vertices, dtype=np.float64)[np.asarray(drawn.faces)])
    if isinstance(drawn, PointCloudHandle):
        return _balls(start, way, np.asarray(drawn.points, dtype=np.float64), float(np.max(drawn.point_size)))
    return np.inf


def _triangles(origin: Array, direction: Array, corners: Array) -> float:
    """To the nearest of triangles (N, 3, 3), by Moeller and Trumbore, "Fast, minimum storage ray/triangle intersection", 1997."""
    first, one, other = corners[:, 0], corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    across = np.cross(direction, other)
    volume = np.einsum("ij,ij->i", one, across)
    offset = origin - first
    turned = np.cross(offset, one)
    with np.errstate(divide="ignore", invalid="ignore"):  # of a triangle seen edge-on
        u, v = np.einsum("ij,ij->i", offset, across) / volume, turned @ direction / volume
        along = np.einsum("ij,ij->i", other, turned) / volume
        hit = (u >= 0.0) & (v >= 0.0) & (u + v <= 1.0) & (along > 0.0)
    return float(along[hit].min(initial=np.inf))


def _balls(origin: Array, direction: Array, centres: Array, radius: float) -> float:
    """To the nearest of points (N, 3) that the ray passes within `radius` (m)."""
    along = (centres - origin) @ direction
    missed = np.linalg.norm(centres - origin - along[:, None] * direction, axis=1)
    return float(along[(missed < radius) & (along > 0.0)].min(initial=np.inf))
