"""Closes meshes with small faults, where that adds obstacles only in places that nothing can pass."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from zarm_trajectory.arrays import Array

if TYPE_CHECKING:
    from trimesh import Trimesh


SMALL = 0.01
"""Holes up to this wide (m) are closed: no part of an arm reaches through."""


def closed(mesh: Trimesh) -> tuple[Trimesh | None, tuple[str, ...]]:
    """The mesh as a closed, consistently wound surface, or None if that is impossible; and the repairs or faults, a
    sentence each.

    Coinciding vertices and duplicate triangles are merged, triangles wound against their neighbours are flipped, and
    holes up to SMALL are closed with a fan of triangles around their middle.
    """
    from trimesh import repair  # takes half a second, which a planner without meshes need not spend

    notes: list[str] = []
    mesh.merge_vertices()
    a, b, c = mesh.faces.T
    mesh.update_faces((a != b) & (b != c) & (c != a))
    once = mesh.unique_faces()
    if not once.all():
        mesh.update_faces(once)
        notes.append("triangles that were there more than once were taken once")
    if not mesh.is_winding_consistent:
        repair.fix_winding(mesh)  # type: ignore[no-untyped-call]
        if mesh.is_winding_consistent:
            notes.append("triangles that were wound against their neighbours were turned")
    if not mesh.is_watertight:
        mesh, holes, widest = _filled(mesh)
        if holes:
            many = f"{holes} holes" if holes > 1 else "a hole"
            notes.append(f"{many} of at most {SMALL * 1e3:g} mm closed")
        if widest > SMALL:
            return None, (*notes, f"it has a hole {widest:.3g} m wide: only its surface is an obstacle, not its inside")
    if not mesh.is_watertight or not mesh.is_winding_consistent:
        return None, (*notes, "its surface does not part an inside from an outside: only the surface is an obstacle")
    return mesh, tuple(notes)


def _filled(mesh: Trimesh) -> tuple[Trimesh, int, float]:
    """The mesh with its small holes closed, their number, and the width (m) of the widest hole it had."""
    from trimesh import Trimesh, graph, grouping

    rim = mesh.edges[grouping.group_rows(mesh.edges_sorted, require_count=1)]  # type: ignore[no-untyped-call]
    vertices: list[Array] = [mesh.vertices]
    faces: list[NDArray[np.int64]] = [mesh.faces]
    count, widest = 0, 0.0
    for hole in graph.connected_components(rim, min_len=3):
        corners = mesh.vertices[hole]
        width = float(np.linalg.norm(np.ptp(corners, axis=0)))
        widest = max(widest, width)
        if width > SMALL:
            continue
        around = rim[np.isin(rim[:, 0], hole)]
        middle = np.full(len(around), len(mesh.vertices) + count)
        vertices.append(corners.mean(axis=0, keepdims=True))
        faces.append(np.column_stack([around[:, 1], around[:, 0], middle]))
        count += 1
    return Trimesh(np.vstack(vertices), np.vstack(faces), process=False), count, widest
