"""Which reader reads which file."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import PurePath

from zarm_geometry.mesh_files import collada, gltf, obj, ply, stl
from zarm_geometry.mesh_files.mesh_file import MeshFile, Unreadable

Beside = Callable[[str], bytes]
"""The content of a file by its path relative to the mesh file; raises OSError."""

_ALONE = {".stl": stl.read, ".obj": obj.read, ".dae": collada.read, ".ply": ply.read}
_POINTER = b"version https://git-lfs"
FORMATS = (*_ALONE, ".glb", ".gltf")
"""Suffixes of the files that can be read, in lower case."""


def read(name: str, content: bytes, beside: Beside | None = None) -> MeshFile:
    """The triangles of a file with this name and content, by the name's suffix.

    Only a .gltf names other files that hold geometry; without `beside` none is read, and such a file is refused. Raises
    Unreadable.
    """
    suffix = PurePath(name).suffix.lower()
    if content.startswith(_POINTER):
        raise Unreadable("it is not the mesh but a pointer of Git LFS; run `git lfs pull` where it was cloned")
    if suffix in _ALONE:
        return _ALONE[suffix](content)
    if suffix in FORMATS:
        return gltf.read(content, beside)
    raise Unreadable(f"it is of no known format; convert it to one of {', '.join(FORMATS)}")
