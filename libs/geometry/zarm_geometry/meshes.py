"""Meshes of the scene: read from configured folders, checked, and turned into convex shapes."""

from __future__ import annotations

import gc
import hashlib
import stat
from base64 import b64decode
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from zarm_contract.errors import InvalidRequest, Unavailable
from zarm_contract.messages import Mesh, Voxels
from zarm_geometry import mesh_files, packed_shapes
from zarm_geometry.box_tree import BoxTree
from zarm_geometry.mesh_repair import closed
from zarm_geometry.solid import around, inside
from zarm_geometry.voxels import cells_of, coarse
from zarm_trajectory.arrays import Array

MAX_TRIANGLES = 100_000
MAX_BYTES = 32 * 1024 * 1024
MAX_VERTEX_DISTANCE = 1e3
"""No vertex is further (m) from the mesh's origin."""
LARGE = 10.0
"""Beyond this size (m) a mesh is most likely in mm: a part of 10 mm would be as large as a hall."""
SMALLEST = 1e-3
"""Below this size (m) a mesh is most likely in km, or scaled twice: an arm would pass through what is there."""
_SUFFIXES = (".stl", ".obj")

_Known = tuple[str, tuple[float, float, float]]
"""Digest of a file and scale."""


class _Read(NamedTuple):
    """The content of a file: the tree over its shapes, and a sentence about each of its faults."""

    tree: BoxTree
    notes: tuple[str, ...]


class Meshes:
    """Shapes of meshes, by the content of their files: a file is read when a mesh is added, and once after a start.

    A closed mesh is solid: its inside is filled with boxes. Small faults are repaired, see `mesh_repair`; if a mesh is
    still open, only its surface is an obstacle.
    """

    def __init__(self, folders: Sequence[Path] = ()) -> None:
        self._folders = tuple(folders)
        self._known: dict[_Known, _Read] = {}

    def checked(self, item: Mesh, field: str) -> Mesh:
        """The mesh with its file's digest; its shapes are now known. Raises InvalidRequest."""
        digest, _ = self._read(item, field)
        return item.model_copy(update={"sha256": digest})

    def tree(self, item: Mesh) -> BoxTree:
        """The tree over the shapes of a scene mesh, in its own frame.

        Raises Unavailable if its file has to be read again and is missing or has changed.
        """
        known = self._known.get((item.sha256 or "", item.scale))
        if known is not None:
            return known.tree
        try:
            return self._read(item, "")[1].tree
        except InvalidRequest as error:
            raise Unavailable(
                f"the scene holds the mesh {item.name}, which cannot be read: {error.problem.message}. Until its file is "
                f"back, or {item.name} is removed or replaced, nothing can be planned"
            ) from error

    def around(self, item: Mesh | Voxels, most: int) -> tuple[Array, Array]:
        """At most `most` boxes that enclose an object, by their corners (m, 3) in its own frame. Raises Unavailable
        like `rows`.
        """
        if isinstance(item, Voxels):
            return coarse(cells_of(item), item.resolution, most)
        shapes = self.tree(item).rows
        flat = shapes[:, 15] < 0.0
        return around(packed_shapes.corners(shapes[flat]), most, solid=not flat.all())

    def count(self, item: Mesh) -> int:
        """The number of shapes of a mesh; 0 while its file cannot be read."""
        known = self._known.get((item.sha256 or "", item.scale))
        return 0 if known is None else len(known.tree.rows)

    def notes(self, item: Mesh) -> tuple[str, ...]:
        """Notes on a checked mesh: what was repaired, and whether only its surface is an obstacle."""
        known = self._known.get((item.sha256 or "", item.scale))
        return () if known is None else tuple(f"{item.name}: {note}" for note in known.notes)

    def keep(self, items: Iterable[Mesh]) -> None:
        """Forget the shapes of all other meshes."""
        wanted = {(item.sha256, item.scale) for item in items}
        self._known = {key: value for key, value in list(self._known.items()) if key in wanted}

    def _read(self, item: Mesh, field: str) -> tuple[str, _Read]:
        """The digest and the content of a mesh's file."""
        content = self._content(item, field)
        digest = hashlib.sha256(content).hexdigest()
        if item.sha256 not in (None, digest):
            raise InvalidRequest(
                f"{item.name}: the file {item.file} is not the one with the given sha256; restore that one, or leave "
                "sha256 out to use the present one",
                field=f"{field}.sha256",
            )
        known = self._known.get((digest, item.scale))
        if known is None:
            known = self._known[digest, item.scale] = _held(item, content, field)
            gc.collect()  # trimesh's meshes refer to themselves: few objects, but tens of MB
        return digest, known

    def _content(self, item: Mesh, field: str) -> bytes:
        """The bytes of the mesh's file. A link that leads out of the folders is not followed further."""

        def refused(reason: str) -> InvalidRequest:
            return InvalidRequest(f"{item.name}: {reason}", field=f"{field}.file")

        if Path(item.file).suffix.lower() not in _SUFFIXES:
            raise refused(f"{item.file} is neither an .stl nor an .obj file; convert it to one of these")
        if item.data is not None:
            return _decoded(item, field)
        if not self._folders:
            raise refused("this planner reads no meshes; start it with --meshes FOLDER")
        for folder in self._folders:
            try:
                home = folder.resolve(strict=True)
                path = (home / item.file).resolve(strict=True)
                if not path.is_relative_to(home):
                    raise refused(
                        f"{item.file} lies outside the mesh folders; copy it into one, and name it relative to that"
                    )
                about = path.stat()
                if not stat.S_ISREG(about.st_mode):
                    raise refused(f"{item.file} is not a file")
                if about.st_size > MAX_BYTES:
                    raise refused(f"{item.file} has {about.st_size} bytes, more than {MAX_BYTES}; simplify the mesh")
                return path.read_bytes()
            except FileNotFoundError:
                continue
            except (OSError, ValueError, RuntimeError) as error:  # a null character or a loop of links, too
                raise refused(f"cannot read {item.file}: {getattr(error, 'strerror', None) or error}") from error
        raise refused(f"there is no file {item.file} in {', '.join(map(str, self._folders))}; check the name")


def _decoded(item: Mesh, field: str) -> bytes:
    """The content that a mesh carries itself. Raises InvalidRequest."""
    try:
        return b64decode(item.data or "", validate=True)
    except ValueError as error:
        raise InvalidRequest(f"{item.name}: this is no base64: {error}", field=f"{field}.data") from error


def _held(item: Mesh, content: bytes, field: str) -> _Read:
    """The parsed content of a file. Raises InvalidRequest."""
    from trimesh import Trimesh  # takes half a second, which a planner without meshes need not spend

    def refused(reason: str) -> InvalidRequest:
        return InvalidRequest(f"{item.name}: {reason}", field=f"{field}.file")

    try:
        # From memory alone, so that a file cannot cause other files to be read.
        read = mesh_files.read(item.file, content)
    except mesh_files.Unreadable as error:
        raise refused(f"{item.file} cannot be read: {error}") from error
    if len(read.triangles) > MAX_TRIANGLES:
        raise refused(f"{item.file} has {len(read.triangles)} triangles, more than {MAX_TRIANGLES}; simplify the mesh")
    used = read.triangles * item.scale
    if not np.isfinite(used).all():
        raise refused(f"{item.file} has vertices that are not numbers; export it again")
    if np.abs(used).max() > MAX_VERTEX_DISTANCE:
        raise refused(
            f"{item.file} reaches further than {MAX_VERTEX_DISTANCE:g} m from its origin; meshes are in m, so give one that is in mm "
            "the scale 0.001"
        )
    size = float(np.ptp(used.reshape(-1, 3), axis=0).max())
    surface = packed_shapes.triangles(used)
    if not len(surface):
        raise refused(f"{item.file} holds only triangles without area; check the scale, or export it again")
    if size < SMALLEST:
        raise refused(
            f"{item.file} is {1e3 * size:.2g} mm large, too small to be an obstacle; meshes are in m, so check the unit of its "
            "export, and its scale"
        )
    notes = [*read.notes, *_doubts(size, len(read.triangles) - len(surface))]
    vertices, faces = np.unique(used.reshape(-1, 3), axis=0, return_inverse=True)
    solid, repairs = closed(Trimesh(vertices, faces.reshape(-1, 3), process=False))
    shapes = [surface] if solid is None else [surface, packed_shapes.boxes(*inside(np.asarray(solid.triangles)))]
    return _Read(BoxTree.over(np.concatenate(shapes)), (*notes, *repairs))


def _doubts(size: float, flat: int) -> list[str]:
    """Sentences about a mesh of a size (m) that few objects beside an arm have, and about its triangles without area."""
    doubts = []
    if size > LARGE:
        doubts.append(f"it is {size:.3g} m large: if its file is in mm, give it the scale 0.001")
    if flat:
        doubts.append(f"{flat} of its triangles have no area, so they are no obstacle")
    return doubts
