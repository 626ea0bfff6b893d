"""Shapes in the picture: primitives of the scene and of a robot's links, meshes and voxels."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import trimesh
import viser
from numpy.typing import NDArray
from viser import MeshHandle, SceneNodeHandle
from viser.transforms import SE3

from zarm_contract.messages import Capsule, Cuboid, Cylinder, Mesh, SceneObject, Sphere, Voxels
from zarm_contract.robot import CollisionCapsule, CollisionCuboid, CollisionCylinder, CollisionPrimitive
from zarm_viewer.kinematics import pose_of

Colour = tuple[int, int, int]

MOST_POINTS = 20_000
"""So many voxels of one object are drawn at most; of more, every second, third, ..."""
_SEGMENTS = 24


@dataclass(frozen=True)
class Brush:
    """How a shape is drawn; `opacity` 1 hides what is behind it."""

    api: viser.SceneApi
    colour: Colour
    opacity: float = 1.0

    def cuboid(self, name: str, size: tuple[float, float, float], at: SE3) -> SceneNodeHandle:
        """A box with edges of `size` (m), centred at a pose."""
        return self._mesh(name, trimesh.creation.box(size), at, flat=True)

    def ball(self, name: str, radius: float, at: SE3) -> SceneNodeHandle:
        """A ball (m)."""
        return self._mesh(name, trimesh.creation.icosphere(2, radius), at)

    def cylinder(self, name: str, radius: float, length: float, at: SE3) -> SceneNodeHandle:
        """A cylinder (m) along z, centred at a pose."""
        return self._mesh(name, trimesh.creation.cylinder(radius, length, sections=2 * _SEGMENTS), at, flat=True)

    def capsule(self, name: str, radius: float, length: float, at: SE3) -> SceneNodeHandle:
        """All points within `radius` (m) of a segment of `length` (m) along z, centred at a pose."""
        mesh = trimesh.creation.capsule(length, radius, count=(_SEGMENTS, _SEGMENTS))
        mesh.apply_translation((0.0, 0.0, -mesh.bounds.mean(axis=0)[2]))
        return self._mesh(name, mesh, at)

    def file(self, name: str, file: Path, scale: tuple[float, float, float], at: SE3) -> SceneNodeHandle:
        """The triangles of a file, times `scale`. Raises ValueError and OSError for one that cannot be read."""
        mesh = trimesh.load_mesh(file, process=False, skip_materials=True)
        mesh.apply_scale(scale)  # type: ignore[no-untyped-call]
        return self._mesh(name, mesh, at, flat=True)

    def voxels(self, name: str, item: Voxels, at: SE3) -> SceneNodeHandle:
        """Occupied cells as points, thinned out where there are many."""
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

    def _mesh(self, name: str, mesh: trimesh.Trimesh, at: SE3, *, flat: bool = False) -> MeshHandle:
        return self.api.add_mesh_simple(
            name,
            np.asarray(mesh.vertices, dtype=np.float32),
            np.asarray(mesh.faces, dtype=np.uint32),
            color=self.colour,
            opacity=None if self.opacity == 1.0 else self.opacity,
            flat_shading=flat,
            side="double",
            cast_shadow=self.opacity == 1.0,
            wxyz=at.rotation().wxyz,
            position=at.translation(),
        )


def draw_primitive(brush: Brush, name: str, primitive: CollisionPrimitive) -> SceneNodeHandle:
    """A primitive of the robot descriptor, in the frame of its link."""
    if isinstance(primitive, CollisionCuboid):
        return brush.cuboid(name, primitive.size, pose_of(primitive.center, primitive.orientation))
    if isinstance(primitive, CollisionCapsule | CollisionCylinder):
        at, length = _between(np.array(primitive.a), np.array(primitive.b))
        draw = brush.capsule if isinstance(primitive, CollisionCapsule) else brush.cylinder
        return draw(name, primitive.radius, length, at)
    return brush.ball(name, primitive.radius, SE3.from_translation(np.array(primitive.center)))


def draw_object(brush: Brush, name: str, item: SceneObject, meshes: tuple[Path, ...]) -> SceneNodeHandle | None:
    """An object of the scene, in the frame that its pose is in; None where its mesh lies in none of the folders `meshes`."""
    if isinstance(item, Sphere):
        return brush.ball(name, item.radius, SE3.from_translation(np.array(item.position)))
    at = pose_of(item.position, item.orientation)
    match item:
        case Cuboid():
            return brush.cuboid(name, item.size, at)
        case Capsule():
            return brush.capsule(name, item.radius, item.length, at)
        case Cylinder():
            return brush.cylinder(name, item.radius, item.length, at)
        case Voxels():
            return brush.voxels(name, item, at)
        case Mesh():
            return _draw_mesh(brush, name, item, at, meshes)


def _draw_mesh(brush: Brush, name: str, item: Mesh, at: SE3, meshes: tuple[Path, ...]) -> SceneNodeHandle | None:
    for folder in meshes:
        file = (folder / item.file).resolve()
        if file.is_relative_to(folder.resolve()) and file.is_file():
            try:
                return brush.file(name, file, item.scale, at)
            except (ValueError, OSError):
                return None
    return None


def _between(a: NDArray[np.float64], b: NDArray[np.float64]) -> tuple[SE3, float]:
    """The pose half-way from a to b whose z leads along it, and the distance (m)."""
    length = float(np.linalg.norm(b - a))
    pose = np.eye(4)
    pose[:3, 3] = (a + b) / 2
    if length > 0.0:
        pose[:3, :3] = trimesh.geometry.align_vectors((0.0, 0.0, 1.0), b - a)[:3, :3]  # type: ignore[no-untyped-call]
    return SE3.from_matrix(pose), length
