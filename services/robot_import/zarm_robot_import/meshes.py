"""The surface of each link as triangles, from meshes and primitives."""

from __future__ import annotations

import logging
import math
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import NDArray

from zarm_contract.errors import InvalidRequest, Unavailable
from zarm_robot_import.chain import LARGEST
from zarm_robot_import.description import Geometry, Link
from zarm_robot_import.source import Source
from zarm_robot_import.surface_distance import sticks_out
from zarm_robot_import.triangles import gathered

Array = NDArray[np.float64]

MOST_TRIANGLES = 3_000_000
MOST_KEPT = 200_000
"""Most triangles of a link used in computations."""
SMALLEST = 1e-3
"""A link smaller than this (m) in all directions is ignored."""
_FLATTEST = 1e-9
"""A smaller scale collapses a mesh."""
CONTAINED = 0.001
"""Collision geometry counts as containing the visual one if that protrudes by at most this (m)."""
_POINTER = b"version https://git-lfs"
SUFFIXES = (".stl", ".dae", ".obj", ".ply", ".glb", ".gltf", ".off")


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
                triangles, file = _triangles(source, geometry, link.name)
            except _Missing as error:
                missing[kind] = str(error)
                continue
            if file:
                files.append(file)
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
    found = {kind: triangles for kind, triangles in found.items() if _size(triangles) > SMALLEST}
    if not found:
        return None
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


def _size(triangles: Array) -> float:
    return float(np.ptp(triangles.reshape(-1, 3), axis=0).max()) if len(triangles) else 0.0


def _cleaned(triangles: Array) -> tuple[Array, int]:
    """The finite ones, and the number of the others."""
    kept: Array = triangles[np.isfinite(triangles).all(axis=(1, 2))]
    return kept, len(triangles) - len(kept)


def _triangles(source: Source, geometry: Geometry, link: str) -> tuple[Array, Path | None]:
    """The triangles of a geometry in its own frame, and its file."""
    place = source.place(geometry.element)
    if geometry.kind != "mesh":
        if any(size <= 0.0 for size in geometry.size):
            return np.empty((0, 3, 3)), None
        return _primitive(geometry), None
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
    if file.suffix.lower() not in SUFFIXES:
        raise InvalidRequest(f"{place}: link {link}: {file.name} is of no known format; convert it to STL, OBJ or DAE")
    if any(abs(factor) < _FLATTEST for factor in geometry.scale):
        raise InvalidRequest(f"{place}: link {link}: the scale {geometry.scale} collapses the mesh; write 1 1 1")
    try:
        triangles = _load(file)
    except _Unreadable as error:
        raise InvalidRequest(f"{place}: link {link}: {error}") from error
    if math.prod(geometry.scale) < 0.0:
        triangles = triangles[:, ::-1]  # mirrored: keep the orientation outwards
    return triangles * geometry.scale, file


class _Unreadable(Exception):
    pass


@lru_cache(maxsize=64)
def _load(file: Path) -> Array:
    """The triangles of a file, in m if the file states its unit."""
    logging.getLogger("trimesh").setLevel(logging.CRITICAL)
    try:
        with file.open("rb") as opened:
            start = opened.read(len(_POINTER))
    except OSError as error:
        raise _Unreadable(f"{file} cannot be read: {error.strerror}; check its permissions") from error
    if start == _POINTER:
        raise _Unreadable(f"{file} is not the mesh but a pointer of Git LFS; run `git lfs pull` where it was cloned")
    try:
        loaded = trimesh.load_scene(file, process=False, skip_materials=True)
        meshes = loaded.dump()
    except ImportError as error:
        if file.suffix.lower() == ".dae":
            raise Unavailable(f"{file} needs the package pycollada; `pip install zarm[import]`") from error
        raise _Unreadable(f"{file} cannot be read: {error}; export it again") from error
    except Exception as error:  # parsers of broken files raise all kinds of errors
        raise _Unreadable(f"{file} cannot be read: {' '.join(str(error).split())[:200]}; export it again") from error
    parts = [np.asarray(mesh.triangles, np.float64) for mesh in meshes if hasattr(mesh, "triangles")]
    if not parts or not sum(map(len, parts)):
        raise _Unreadable(f"{file} holds no triangles; export it again")
    count = sum(map(len, parts))
    if not any(np.isfinite(part).all(axis=(1, 2)).any() for part in parts):
        raise _Unreadable(f"{file} has only NaN or infinite coordinates; export it again")
    if count > MOST_TRIANGLES:
        raise _Unreadable(f"{file} has {count} triangles, more than {MOST_TRIANGLES}; simplify it")
    triangles = np.concatenate(parts)
    return triangles * _unit(file) if file.suffix.lower() == ".dae" else triangles


def _unit(file: Path) -> float:
    """Metres per unit of a COLLADA file, as RViz interprets it."""
    import collada

    unit = collada.Collada(str(file), ignore=[collada.common.DaeError]).assetInfo.unitmeter
    return float(unit) if unit else 1.0


def _primitive(geometry: Geometry) -> Array:
    match geometry.kind:
        case "box":
            mesh = trimesh.creation.box(geometry.size)
        case "cylinder":
            mesh = trimesh.creation.cylinder(geometry.size[0], geometry.size[1], sections=48)
        case "capsule":
            mesh = trimesh.creation.capsule(geometry.size[1], geometry.size[0])
        case _:
            mesh = trimesh.creation.icosphere(subdivisions=3, radius=geometry.size[0])
    return np.asarray(mesh.triangles, np.float64)
