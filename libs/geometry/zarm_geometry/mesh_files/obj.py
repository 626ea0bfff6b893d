"""Wavefront OBJ: polygons on a list of vertices. It states no unit; materials, which are in other files, are not read."""

from __future__ import annotations

import re
from collections import Counter

import numpy as np

from zarm_geometry.mesh_files.mesh_file import MeshFile, Unreadable, accounted, many
from zarm_geometry.mesh_files.polygons import triangulated
from zarm_geometry.mesh_files.text import plain, shown

# By the specification of Wavefront's Advanced Visualizer, appendix B1.
_NO_GEOMETRY = frozenset(
    b"vt vn g o s mg usemtl mtllib usemap maplib bevel c_interp d_interp lod shadow_obj trace_obj".split()
)
"""Names, texture and looks."""
_CURVES = frozenset(b"vp cstype deg bmat step curv curv2 parm trim hole scrv sp end con ctech stech".split())
"""Parts of free forms; without a surface they are curves, which no arm touches."""
_SURFACES = frozenset(b"surf bzp bsp cdc cdp res".split())
_OTHERS = frozenset(b"call csh".split())
_FACE = re.compile(rb"(?m)^[ \t]*fo?[ \t]")


def read(content: bytes) -> MeshFile:
    """The triangles of all groups and objects. Raises Unreadable."""
    lines, numbers = _lines(plain(content))
    coordinates: list[bytes] = []
    corners: list[int] = []
    sizes: list[int] = []
    origins: list[int] = []
    """Of each face, the line."""
    left: Counter[bytes] = Counter()
    count = 0
    for at, line in enumerate(lines):
        if b"#" in line:
            line = line.partition(b"#")[0]
        words = line.split()
        if not words:
            continue
        kind = words[0]
        if kind == b"v":
            if len(words) < 4 or (len(words) == 5 and not _is_one(words[4])):
                raise _fault(numbers[at], "a vertex has three coordinates, and no weight but 1")
            coordinates += words[1:4]
            count += 1
        elif kind in (b"f", b"fo"):
            face = _face(words, count, line, numbers[at])
            corners += face
            sizes.append(len(face))
            origins.append(at)
        elif kind in (b"l", b"p") or kind in _CURVES:
            left[kind] += 1
        elif kind not in _NO_GEOMETRY:
            raise _fault(numbers[at], _refusal(kind))
    try:
        points = np.array(list(map(float, coordinates))).reshape(-1, 3)
    except ValueError:
        raise _not_numbers(lines, numbers) from None
    index, size = np.array(corners, np.int64), np.array(sizes, np.int64)
    if len(index) and index.max() >= count:
        first = int(np.searchsorted(np.cumsum(size), np.argmax(index >= count), side="right"))
        raise _fault(numbers[origins[first]], f"a face names the vertex {index.max() + 1}, and there are {count}")
    triangles = triangulated(points, size, index)
    accounted("faces", len(_FACE.findall(b"\n".join(lines))), len(sizes))
    accounted("triangles", int(np.maximum(size - 2, 0).sum()), len(triangles))
    if not len(triangles):
        raise Unreadable("it holds no triangles; export it again")
    return MeshFile(points[triangles], tuple(_notes(left, int((size < 3).sum()))))


def _face(words: list[bytes], count: int, line: bytes, number: int) -> list[int]:
    """The vertices of a face, counted from 0; `count` of them stand before it."""
    try:
        face = [int(word.partition(b"/")[0]) for word in words[1:]]
    except ValueError:
        raise _fault(number, f"{shown(line)} does not name vertices by their numbers") from None
    for named in face:
        if named == 0 or named < -count:
            raise _fault(number, f"a face names the vertex {named}, and {count} stand before it")
    return [named - 1 if named > 0 else count + named for named in face]


def _refusal(kind: bytes) -> str:
    if kind in _SURFACES:
        return f"{shown(kind)} is a free-form surface; export it as polygons"
    if kind in _OTHERS:
        return f"{shown(kind)} takes in another file, which is never done; export it as one file"
    return f"{shown(kind)} is no word of an OBJ file"


def _lines(text: bytes) -> tuple[list[bytes], range | list[int]]:
    """The lines, joined where one ends with a backslash, and their numbers."""
    lines = text.splitlines()
    if b"\\\n" not in text and b"\\\r" not in text:
        return lines, range(1, len(lines) + 1)
    joined: list[bytes] = []
    numbers: list[int] = []
    open_ended = False
    for number, line in enumerate(lines, 1):
        ends, line = line.endswith(b"\\"), line.removesuffix(b"\\")
        if open_ended:
            joined[-1] += b" " + line
        else:
            joined.append(line)
            numbers.append(number)
        # A comment ends with its line.
        open_ended = ends and b"#" not in joined[-1]
    return joined, numbers


def _is_one(word: bytes) -> bool:
    try:
        return float(word) == 1.0
    except ValueError:
        return False


def _fault(line: int, what: str) -> Unreadable:
    return Unreadable(f"line {line}: {what}; correct it, or export it again")


def _not_numbers(lines: list[bytes], numbers: range | list[int]) -> Unreadable:
    for at, line in enumerate(lines):
        words = line.partition(b"#")[0].split()
        if words[:1] == [b"v"]:
            try:
                list(map(float, words[1:4]))
            except ValueError:
                return _fault(numbers[at], f"{shown(line)} are not three numbers")
    return Unreadable("a vertex has no numbers; export it again")


def _notes(left: Counter[bytes], thin: int) -> list[str]:
    notes = []
    if count := left.pop(b"l", 0):
        notes.append(f"{many(count, 'line')}, which no arm touches, are not taken")
    if count := left.pop(b"p", 0):
        notes.append(f"{many(count, 'element')} of points, which no arm touches, are not taken")
    if left:
        words = ", ".join(sorted(word.decode() for word in left))
        notes.append(f"curves ({words}), which no arm touches, are not taken")
    if thin:
        notes.append(f"{many(thin, 'face')} of fewer than 3 corners have no area and are not taken")
    return notes
