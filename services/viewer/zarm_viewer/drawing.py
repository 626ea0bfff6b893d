"""Draws shapes: primitives of the scene and of links, meshes and voxels."""

from __future__ import annotations

from base64 import b64decode
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import cast

import numpy as np
import trimesh
import viser
from numpy.typing import NDArray
from viser import MeshHandle, SceneNodeHandle
from viser.transforms import SE3

from zarm_contract.collision import CollisionCapsule, CollisionCuboid, CollisionCylinder, CollisionPrimitive
from zarm_contract.messages import Capsule, Cuboid, Cylinder, Mesh, SceneObject, Sphere, Voxels
from zarm_geometry import mesh_files
from zarm_geometry.visual_meshes import file_triangles
from zarm_trajectory.arrays import Array
from zarm_viewer.kinematics import pose_of

Colour = tuple[int, int, int]
Shape = tuple[trimesh.Trimesh, SE3]
"""A mesh (m) and its pose."""

MOST_POINTS = 20_000
"""Most voxels drawn of one object; of more, only every second, third, ..."""
_SEGMENTS = 16


@dataclass(frozen=True)
class Brush:
    """How shapes are drawn; with `opacity` 1 they hide what is behind them."""

    api: viser.SceneApi
    colour: Colour
    opacity: float = 1.0

    def mesh(self, name: str, mesh: trimesh.Trimesh, at: SE3) -> MeshHandle:
        """Triangles (m), in a frame at a pose."""
        return self.api.add_mesh_simple(
            name,
            np.asarray(mesh.vertices, dtype=np.float32),
            np.asarray(mesh.faces, dtype=np.uint32),
            color=self.colour,
            opacity=None if self.opacity == 1.0 else self.opacity,
            side="front" if self.opacity == 1.0 else "double",
            cast_shadow=False,
            receive_shadow=False,
            wxyz=at.rotation().wxyz,
            position=at.translation(),
        )

    def voxels(self, name: str, item: Voxels, at: SE3) -> SceneNodeHandle:
        """Occupied cells as points, thinned out if there are many."""
        cells = np.array(item.cells, dtype=np.float32)
        thin = -(-len(cells) // MOST_POINTS)
        return self.api.add_point_cloud(
            name,
            cells[::thin] * item.resolution,
            self.colour,
            point_size=item.resolution,
            point_shape="square",
            precision="float32",
            wxyz=at.rotation().wxyz,
            position=at.translation(),
        )


def link_mesh(primitives: Sequence[CollisionPrimitive]) -> trimesh.Trimesh:
    """The exact geometry of a link as one mesh, in the link's frame: a browser draws few large meshes faster than many
    small ones.

    Triangles inside another primitive are left out, since they are visible only in a ghost.
    """
    meshes = [_primitive(primitive) for primitive in primitives]
    seen = [~_hidden(mesh, [other for other in meshes if other is not mesh]) for mesh in meshes]
    for mesh, faces in zip(meshes, seen, strict=True):
        mesh.update_faces(faces)
        mesh.remove_unreferenced_vertices()
    return cast(trimesh.Trimesh, trimesh.util.concatenate(meshes))


def held_mesh(name: str, content: bytes, scale: tuple[float, float, float]) -> trimesh.Trimesh:
    """The triangles of a file with this content in m, times `scale`. Raises ValueError if it cannot be read."""
    try:
        read = mesh_files.read(name, content)
    except mesh_files.Unreadable as error:
        raise ValueError(f"{name} cannot be read: {error}") from error
    return surface(read.triangles * scale)


def surface(triangles: Array) -> trimesh.Trimesh:
    """The mesh of some triangles (n, 3, 3), in m."""
    points = triangles.reshape(-1, 3)
    return _edged(trimesh.Trimesh(points, np.arange(len(points)).reshape(-1, 3), process=False))


def draw_object(brush: Brush, name: str, item: SceneObject, meshes: tuple[Path, ...]) -> SceneNodeHandle | None:
    """A scene object, in the frame of its pose; None if its mesh is in none of the folders `meshes`."""
    if isinstance(item, Sphere):
        return brush.mesh(name, _ball(item.radius), SE3.from_translation(np.array(item.position)))
    at = pose_of(item.position, item.orientation)
    match item:
        case Cuboid():
            return brush.mesh(name, _box(item.size), at)
        case Capsule():
            return brush.mesh(name, _capsule(item.radius, item.length), at)
        case Cylinder():
            return brush.mesh(name, _cylinder(item.radius, item.length), at)
        case Voxels():
            return brush.voxels(name, item, at)
        case Mesh():
            return _draw_mesh(brush, name, item, at, meshes)


def _primitive(primitive: CollisionPrimitive) -> trimesh.Trimesh:
    if isinstance(primitive, CollisionCuboid):
        mesh, at = _box(primitive.size), pose_of(primitive.center, primitive.orientation)
    elif isinstance(primitive, CollisionCapsule | CollisionCylinder):
        at, length = _between(np.array(primitive.a), np.array(primitive.b))
        make = _capsule if isinstance(primitive, CollisionCapsule) else _cylinder
        mesh = make(primitive.radius, length)
    else:
        mesh, at = _ball(primitive.radius), SE3.from_translation(np.array(primitive.center))
    mesh.apply_transform(at.as_matrix())
    return mesh


def _box(size: tuple[float, float, float]) -> trimesh.Trimesh:
    return _edged(trimesh.creation.box(size))


def _ball(radius: float) -> trimesh.Trimesh:
    return cast(trimesh.Trimesh, trimesh.creation.icosphere(2, radius))


def _cylinder(radius: float, length: float) -> trimesh.Trimesh:
    return _edged(trimesh.creation.cylinder(radius, length, sections=2 * _SEGMENTS))


def _capsule(radius: float, length: float) -> trimesh.Trimesh:
    mesh = trimesh.creation.capsule(length, radius, count=(_SEGMENTS, _SEGMENTS))
    mesh.apply_translation((0.0, 0.0, -mesh.bounds.mean(axis=0)[2]))
    return mesh


def _edged(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """The mesh with separate vertices for each triangle, so that edges are visible."""
    mesh.unmerge_vertices()
    return mesh


def _draw_mesh(brush: Brush, name: str, item: Mesh, at: SE3, meshes: tuple[Path, ...]) -> SceneNodeHandle | None:
    if item.data is not None:
        try:
            return brush.mesh(name, held_mesh(item.file, b64decode(item.data), item.scale), at)
        except ValueError:
            return None
    for folder in meshes:
        file = (folder / item.file).resolve()
        if file.is_relative_to(folder.resolve()) and file.is_file():
            try:
                return brush.mesh(name, surface(file_triangles(file, item.scale)), at)
            except (ValueError, OSError):
                return None
    return None


def _hidden(mesh: trimesh.Trimesh, others: Sequence[trimesh.Trimesh]) -> NDArray[np.bool_]:
    """Which triangles of a mesh lie inside one of the others, which are convex: behind the planes of all its faces."""
    hidden = np.zeros(len(mesh.faces), dtype=np.bool_)
    for other in others:
        (low, high), (least, most) = mesh.bounds, other.bounds
        if (low < most).all() and (least < high).all():
            depth = np.einsum("ij,ij->i", other.face_normals, other.triangles[:, 0])
            inside = (mesh.vertices @ other.face_normals.T < depth).all(axis=1)
            hidden |= inside[mesh.faces].all(axis=1)
    return hidden


def _between(a: NDArray[np.float64], b: NDArray[np.float64]) -> tuple[SE3, float]:
    """The pose half-way from a to b with z along this line, and the distance (m)."""
    length = float(np.linalg.norm(b - a))
    pose = np.eye(4)
    pose[:3, 3] = (a + b) / 2
    if length > 0.0:
        pose[:3, :3] = trimesh.geometry.align_vectors((0.0, 0.0, 1.0), b - a)[:3, :3]  # type: ignore[no-untyped-call]
    return SE3.from_matrix(pose), length
