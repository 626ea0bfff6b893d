"""STL (3D Systems, 1988), as text or binary. It states no unit."""

from __future__ import annotations

import re
import struct

import numpy as np

from zarm_geometry.mesh_files.mesh_file import MeshFile, Unreadable, accounted, many
from zarm_geometry.mesh_files.text import plain, shown

_HEADER = 84
_TRIANGLE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
_NUMBER = rb"[-+.\dni]"
_NAME = re.compile(
    rb"(?i)(?:(?<=\s)|^)(end)?[ \t]*solid\b(?:(?!facet\s+normal\s+" + _NUMBER + rb")[^\n])*", re.MULTILINE
)
"""A line that begins or ends a solid, with its name, which may be any words."""
_FACET = b"facet normal 0 0 0 outer loop vertex 0 0 0 vertex 0 0 0 vertex 0 0 0 endloop endfacet".split()
_WORDS = [at for at, word in enumerate(_FACET) if word != b"0"]
_CORNERS = [at for at, word in enumerate(_FACET) if word == b"0"][3:]


def read(content: bytes) -> MeshFile:
    """The triangles of all solids. Raises Unreadable."""
    if len(content) < 15:
        raise Unreadable(f"it has {len(content)} bytes, so it holds no triangles; export it again")
    held = struct.unpack_from("<I", content, 80)[0] if len(content) >= _HEADER else 0
    whole = len(content) == _HEADER + held * _TRIANGLE.itemsize
    # Binary files may begin with "solid" too, so the size decides first.
    return _binary(content, held) if whole or not _is_text(content) else _text(content)


def _is_text(content: bytes) -> bool:
    try:
        start = plain(content).lstrip()
    except Unreadable:
        return False
    return start[:5].lower() == b"solid"


def _binary(content: bytes, held: int) -> MeshFile:
    capacity = (len(content) - _HEADER) // _TRIANGLE.itemsize
    if capacity <= 0:
        raise Unreadable("it is neither text nor binary STL and holds no triangles; export it again")
    rest = content[_HEADER + held * _TRIANGLE.itemsize :]
    if held > capacity or (len(rest) >= _TRIANGLE.itemsize and rest.strip(b"\0")):
        raise Unreadable(
            f"as a binary STL its header announces {many(held, 'triangle')}, and its {len(content)} bytes have room for {capacity}: it is "
            "cut off, damaged or no STL; export it again"
        )
    corners = np.frombuffer(content, _TRIANGLE, held, _HEADER)["corners"].astype(np.float64)
    if not held:
        raise Unreadable("it holds no triangles; export it again")
    notes = (f"the {many(len(rest), 'byte')} after its last triangle are not read",) if rest else ()
    return MeshFile(corners, notes)


def _text(content: bytes) -> MeshFile:
    text = plain(content).replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    begun = ended = 0

    def blank(found: re.Match[bytes]) -> bytes:
        nonlocal begun, ended
        begun, ended = begun + (not found[1]), ended + bool(found[1])
        return b""

    body = _NAME.sub(blank, text)
    if begun != ended:
        raise Unreadable(f"of {many(begun, 'solid')}, {ended} end with endsolid: it is cut off; export it again")
    words = body.split()
    if not words:
        raise Unreadable("it holds no triangles; export it again")
    whole = len(words) // len(_FACET)
    table = np.array(words[: whole * len(_FACET)], dtype=object).reshape(whole, len(_FACET))
    for at in _WORDS:
        expected = _FACET[at]
        wrong = [row for row, word in enumerate(table[:, at].tolist()) if word != expected and word.lower() != expected]
        if wrong:
            raise _fault(body, wrong[0], f"{shown(table[wrong[0], at])} stands where {expected.decode()} belongs")
    if len(words) % len(_FACET):
        raise _fault(body, whole, "it is not complete")
    try:
        numbers = np.array(list(map(float, table[:, _CORNERS].ravel().tolist())))
    except ValueError:
        row = next(row for row in range(whole) if not all(map(_is_number, table[row, _CORNERS].tolist())))
        raise _fault(body, row, "a coordinate is no number") from None
    accounted("facets", len(re.findall(rb"(?i)\bendfacet\b", body)), whole)
    return MeshFile(numbers.reshape(-1, 3, 3))


def _is_number(word: bytes) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


def _fault(body: bytes, row: int, what: str) -> Unreadable:
    starts = [found.start() for found in re.finditer(rb"(?i)\bfacet\b", body)]
    at = starts[min(row, len(starts) - 1)] if starts else 0
    line = body.count(b"\n", 0, at) + 1
    return Unreadable(f"line {line}: triangle {row + 1} of this text STL cannot be read: {what}; export it again")
