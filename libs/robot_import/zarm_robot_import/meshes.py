"""The surface of each link as triangles, from meshes and primitives."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import trimesh

from zarm_contract.errors import InvalidRequest
from zarm_geometry import mesh_files
from zarm_robot_import.chain import LARGEST
from zarm_robot_import.description import Geometry, Link
from zarm_robot_import.source import Source
from zarm_robot_import.surface_distance import sticks_out
from zarm_robot_import.triangles import gathered
from zarm_trajectory.arrays import Array

MOST_TRIANGLES = 3_000_000
MOST_KEPT = 200_000
"""Most triangles of a link used in computations."""
SMALLEST = 1e-3
"""A link smaller than this (m) in all directions is ignored."""
_FLATTEST = 1e-9
"""A smaller scale collapses a mesh."""
_LARGEST_MOVED, _LARGEST_BASE, _LEAST_REACH = 4.0, 10.0, 0.5
"""How many times as large as the arm's reach a link may be, and the least reach (m) that counts."""
CONTAINED = 0.001
"""Collision geometry counts as containing the visual one if that protrudes by at most this (m)."""
THIN = 1e-3
"""Geometry that is flat becomes a solid of this thickness (m): there is no sphere or box inside a plane."""


@dataclass
class Surface:
    """The shells of a link: the triangles (n, 3, 3) of each kind of its geometry that is taken, in its own frame, in m; the
    reason for this choice; and remarks.
    """

    link: str
    shells: dict[str, Array]
    reason: str
    warnings: list[str] = field(default_factory=list)
    files: list[Path] = field(default_factory=list)
    off: float = 0.0
    """How far (m) the link's true surface may be from these triangles, if it had too many to compute with."""

    @property
    def triangles(self) -> Array:
        """Those (n, 3, 3) of all shells."""
        return np.concatenate(list(self.shells.values()))

    @property
    def kind(self) -> str:
        """The kind of geometry that is taken, or `both`."""
        return "both" if len(self.shells) > 1 else next(iter(self.shells))

    def without_visual(self, why: str) -> Surface:
        """The same with the collision geometry alone; `why` completes "the visual mesh is left out, because"."""
        if self.kind != "both":
            return self
        warning = (
            f"the visual mesh is left out, because {why}; obstacles may touch what sticks out of the collision geometry"
        )
        return replace(
            self,
            shells={"collision": self.shells["collision"]},
            reason=why,
            warnings=[*self.warnings, warning],
        )


def link_surface(source: Source, link: Link, prefer: str = "auto") -> Surface | None:
    """The surface of a link's geometry, None if it has none.

    `prefer`: `collision`, `visual`, or `auto`: the collision geometry, together with the visual one if that protrudes
    from it. Raises InvalidRequest for a mesh that is missing or cannot be read.
    """
    warnings: list[str] = []
    files: list[Path] = []
    found: dict[str, Array] = {}
    missing: dict[str, str] = {}
    for kind, geometries in (("collision", link.collision), ("visual", link.visual)):
        if not geometries or (prefer not in ("auto", kind) and getattr(link, prefer)):
            continue
        parts = []
        for geometry in geometries:
            try:
                triangles, file, notes = _triangles(source, geometry, link.name)
            except _Missing as error:
                missing[kind] = str(error)
                continue
            if file:
                files.append(file)
            warnings += [note for note in notes if note not in warnings]
            parts.append(triangles @ geometry.pose[:3, :3].T + geometry.pose[:3, 3])
        if parts:
            found[kind], lost = _cleaned(np.concatenate(parts))
            if lost:
                warnings.append(
                    f"{lost} triangles of its {kind} geometry have NaN or infinite coordinates and are left out; export the mesh again"
                )
    for kind, text in missing.items():
        # A partial link is useless: drop this kind if the other one is complete.
        other = "visual" if kind == "collision" else "collision"
        if other not in found or other in missing:
            raise InvalidRequest(text)
        found.pop(kind, None)
        warnings.append(f"{text.split(';')[0]}; the {other} geometry is taken")
    small = [kind for kind, triangles in found.items() if _size(triangles) <= SMALLEST]
    if len(small) == len(found):
        return None
    for kind in small:
        del found[kind]
        warnings.append(f"its {kind} geometry is smaller than 1 mm, so it is left out; check its size and scale")
    _check_metres(source, link, found)
    surface = _chosen(link, found, prefer)
    surface.warnings[:0], surface.files[:0] = warnings, files
    count = len(surface.triangles)
    for kind, triangles in surface.shells.items():
        surface.shells[kind], off = gathered(triangles, MOST_KEPT // len(surface.shells))
        surface.off = max(surface.off, off)
    if surface.off:
        surface.warnings.append(
            f"its {count} triangles are taken as {len(surface.triangles)}, which makes its geometry up to {1e3 * surface.off:.1f} mm "
            "larger; simplify the mesh for a tighter one"
        )
    return surface


def _check_metres(source: Source, link: Link, found: dict[str, Array]) -> None:
    """Raise InvalidRequest for geometry in mm."""
    for kind, triangles in found.items():
        if (size := _size(triangles)) > LARGEST:
            raise InvalidRequest(
                f"{source.place(link.element)}: link {link.name} is {size:.4g} m large, so its {kind} meshes are in mm; "
                'write scale="0.001 0.001 0.001" into its <mesh> elements'
            )
        if (far := float(np.abs(triangles).max())) > LARGEST:
            raise InvalidRequest(
                f"{source.place(link.element)}: the {kind} geometry of link {link.name} is {far:.4g} m from the link's origin, so it is in "
                "mm; divide the xyz of its <origin> by 1000"
            )


def doubted(surface: Surface, reach: float, moves: bool) -> str | None:
    """The question whether a link has the right unit, None if it is neither far larger nor far smaller than its arm, whose
    joints together reach so far (m).

    Of 56 arms of other people's, no link that moves is larger than 0.9 times the reach, and no base than 2.4 times; a base
    may be a table or a cell. What is exported in mm and read in m is a thousand times too large.
    """
    size, reach = max(map(_size, surface.shells.values())), max(reach, _LEAST_REACH)
    if size <= (_LARGEST_MOVED if moves else _LARGEST_BASE) * reach:
        return None
    return (
        f"link {surface.link} is {size:.3g} m large on an arm that reaches {reach:.2g} m: is its mesh in mm? Then write "
        f'scale="0.001 0.001 0.001" into its <mesh>; if its size is right, say --right-size {surface.link}'
    )


def _chosen(link: Link, found: dict[str, Array], prefer: str) -> Surface:
    """Which of the kinds of geometry found is used, and why."""
    if len(found) == 1:
        (kind,) = found
        other = "visual" if kind == "collision" else "collision"
        asked = prefer == kind and getattr(link, other)
        return Surface(link.name, found, "as asked" if asked else f"no {other} geometry")
    out = sticks_out(found["visual"], found["collision"], CONTAINED)
    if not out:
        return Surface(link.name, {"collision": found["collision"]}, "contains the visual mesh")
    return Surface(link.name, found, f"the visual mesh sticks {1e3 * out:.1f} mm out of the collision geometry")


class _Missing(Exception):
    pass


def _needed(geometry: Geometry) -> tuple[float, ...]:
    """The sizes without which a primitive is flat: a capsule without length is a ball."""
    return geometry.size[:1] if geometry.kind == "capsule" else geometry.size


def _of_no_size(geometry: Geometry) -> str:
    sizes = " x ".join(f"{1e3 * size:g}" for size in geometry.size)
    if not any(geometry.size):
        return f"a {geometry.kind} has the size 0, so it is left out; write its size"
    return f"a {geometry.kind} of {sizes} mm is flat, so it is taken as {1e3 * THIN:g} mm thick"


def _size(triangles: Array) -> float:
    return float(np.ptp(triangles.reshape(-1, 3), axis=0).max()) if len(triangles) else 0.0


def _cleaned(triangles: Array) -> tuple[Array, int]:
    """The finite ones, and the number of the others."""
    kept: Array = triangles[np.isfinite(triangles).all(axis=(1, 2))]
    return kept, len(triangles) - len(kept)


def _triangles(source: Source, geometry: Geometry, link: str) -> tuple[Array, Path | None, list[str]]:
    """The triangles of a geometry in its own frame, its file, and sentences about it."""
    place = source.place(geometry.element)
    if geometry.kind != "mesh":
        return _solid(geometry), None, [] if all(_needed(geometry)) else [_of_no_size(geometry)]
    file = source.file(geometry.file)
    if file is None:
        scheme = geometry.file.rpartition("://")[0]
        remedy = {
            "": "correct the path, which is relative to the URDF",
            "file": "correct the path",
            "package": "name the folder that holds its package with --packages",
            "model": "name the folder that holds its package with --packages",
        }.get(scheme, "zarm fetches nothing: download it, and write its path")
        raise _Missing(f"{place}: link {link}: there is no file {geometry.file}; {remedy}")
    if any(abs(factor) < _FLATTEST for factor in geometry.scale):
        raise InvalidRequest(f"{place}: link {link}: the scale {geometry.scale} collapses the mesh; write 1 1 1")
    try:
        read = _load(file)
    except _Unreadable as error:
        raise InvalidRequest(f"{place}: link {link}: {error}") from error
    notes = [f"{file.name}: {note}" for note in read.notes]
    triangles = (
        read.triangles[:, ::-1] if math.prod(geometry.scale) < 0.0 else read.triangles
    )  # mirrored: still outwards
    triangles, flat = _thickened(triangles * geometry.scale)
    if flat:
        notes.append(f"{file.name} is flat, so it is taken as {1e3 * THIN:g} mm thick")
    return triangles, file, notes


def _thickened(triangles: Array) -> tuple[Array, bool]:
    """Whether all triangles lie in one plane; if so, they are returned as both faces of a thin plate."""
    points = triangles[np.isfinite(triangles).all(axis=(1, 2))].reshape(-1, 3)
    points = points - points.mean(axis=0)
    spread, axes = np.linalg.eigh(points.T @ points)
    if np.ptp(points @ axes[:, 0]) > _FLATTEST + 1e-7 * math.sqrt(max(spread[2], 0.0) / len(points)):
        return triangles, False
    side = axes[:, 0] * THIN / 2
    return np.concatenate([triangles + side, triangles[:, ::-1] - side]), True


class _Unreadable(Exception):
    pass


@lru_cache(maxsize=64)
def _load(file: Path) -> mesh_files.MeshFile:
    """The content of a file, in m if its format or the file states the unit."""
    try:
        read = mesh_files.read(file.name, file.read_bytes(), lambda name: (file.parent / name).read_bytes())
    except OSError as error:
        raise _Unreadable(f"{file} cannot be read: {error.strerror}; check its permissions") from error
    except mesh_files.Unreadable as error:
        raise _Unreadable(f"{file} cannot be read: {error}") from error
    if not np.isfinite(read.triangles).all(axis=(1, 2)).any():
        raise _Unreadable(f"{file} has only NaN or infinite coordinates; export it again")
    if len(read.triangles) > MOST_TRIANGLES:
        raise _Unreadable(f"{file} has {len(read.triangles)} triangles, more than {MOST_TRIANGLES}; simplify it")
    return read


def _solid(geometry: Geometry) -> Array:
    """The triangles of a primitive; those of a flat one are those of a thin solid."""
    if not any(geometry.size):
        return np.empty((0, 3, 3))
    if geometry.kind == "box":
        size = [one or THIN for one in geometry.size]
    else:  # the radius, and a length
        size = [geometry.size[0] or THIN / 2, *(one or THIN for one in geometry.size[1:])]
    match geometry.kind:
        case "box":
            mesh = trimesh.creation.box(size)
        case "cylinder":
            mesh = trimesh.creation.cylinder(size[0], size[1], sections=48)
        case "capsule":
            mesh = trimesh.creation.capsule(geometry.size[1], size[0])
        case _:
            mesh = trimesh.creation.icosphere(subdivisions=3, radius=size[0])
    return np.asarray(mesh.triangles, np.float64)
