"""The visual meshes of a robot: the STL, OBJ and COLLADA files that its URDF names."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from zarm_contract.messages import Vector3
from zarm_geometry import mesh_files
from zarm_geometry.frames import matrix, of_rpy
from zarm_trajectory.arrays import Array

_FORMATS = (".stl", ".obj", ".dae")


def file_triangles(file: Path, scale: Vector3) -> Array:
    """The triangles (n, 3, 3) of a file in m, times `scale`. Raises ValueError and OSError if it cannot be read."""
    try:
        read = mesh_files.read(file.name, file.read_bytes(), lambda name: (file.parent / name).read_bytes())
    except mesh_files.Unreadable as error:
        raise ValueError(f"{file} cannot be read: {error}") from error
    scaled: Array = read.triangles * scale
    return scaled


@dataclass(frozen=True)
class VisualMesh:
    """A visual mesh; `pose` (4, 4) is in the frame of its link."""

    file: Path
    scale: Vector3
    pose: Array

    def triangles(self) -> Array:
        """The triangles (n, 3, 3) in m, in the frame of the link. Raises ValueError and OSError if the file cannot be read."""
        placed: Array = file_triangles(self.file, self.scale) @ self.pose[:3, :3].T + self.pose[:3, 3]
        return placed


def visual_meshes(urdf: Path) -> Mapping[str, tuple[VisualMesh, ...]]:
    """The visual meshes of each link; a link is left out if one of its visuals is not a mesh or is not available here."""
    found: dict[str, tuple[VisualMesh, ...]] = {}
    for link in ET.parse(urdf).getroot().findall("link"):  # noqa: S314 - the robot's own file, read by load_robot before
        visuals = [_visual(element, urdf.parent) for element in link.findall("visual")]
        known = tuple(visual for visual in visuals if visual is not None)
        if known and len(known) == len(visuals):
            found[link.get("name", "")] = known
    return found


def _visual(element: ET.Element, folder: Path) -> VisualMesh | None:
    mesh, at = element.find("geometry/mesh"), element.find("origin")
    if mesh is None:
        return None
    file = folder / mesh.get("filename", "").removeprefix("file://")
    if file.suffix.lower() not in _FORMATS or not file.is_file():
        return None
    pose = matrix((0.0, 0.0, 0.0))
    if at is not None:
        pose[:3, :3] = of_rpy(_numbers(at.get("rpy", "0 0 0")))
        pose[:3, 3] = _numbers(at.get("xyz", "0 0 0"))
    return VisualMesh(file, _numbers(mesh.get("scale", "1 1 1")), pose)


def _numbers(text: str) -> Vector3:
    x, y, z = map(float, text.split())
    return x, y, z
