"""PLY (Turk, 1994), as text or binary. It states no unit."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from zarm_geometry.mesh_files.mesh_file import MeshFile, Unreadable, accounted, many
from zarm_geometry.mesh_files.polygons import strip, triangulated
from zarm_geometry.mesh_files.text import shown

Column = NDArray[np.float64]

_TYPES = {
    "char": "i1",
    "uchar": "u1",
    "short": "i2",
    "ushort": "u2",
    "int": "i4",
    "uint": "u4",
    "float": "f4",
    "double": "f8",
    "int8": "i1",
    "uint8": "u1",
    "int16": "i2",
    "uint16": "u2",
    "int32": "i4",
    "uint32": "u4",
    "float32": "f4",
    "float64": "f8",
}
_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
_LISTS = ("vertex_indices", "vertex_index")


@dataclass
class _Property:
    name: str
    type: str
    length: str | None = None
    """Of a list, the type of its length."""


@dataclass
class _Element:
    name: str
    count: int
    properties: list[_Property] = field(default_factory=list)


@dataclass
class _Table:
    """The values of an element's properties: numbers (count,), or of a list its lengths (count,) and its values, one after
    the other.
    """

    scalars: dict[str, Column]
    lists: dict[str, tuple[NDArray[np.int64], Column]]


def read(content: bytes) -> MeshFile:
    """The triangles of the faces and strips. Raises Unreadable."""
    order, elements, start = _header(content)
    tables: dict[str, _Table] = {}
    body = memoryview(content)[start:]
    reader = _Words(bytes(body)) if not order else _Bytes(body, order)
    for element in elements:
        if element.name in tables:
            raise Unreadable(f"it declares the element {element.name} twice; export it again")
        try:
            tables[element.name] = _table(element, reader)
        except (ValueError, IndexError, MemoryError) as error:
            raise Unreadable(
                f"it announces {many(element.count, element.name)}, and ends or breaks before the last; export it again"
            ) from error
    rest = reader.rest()
    if rest and rest >= 3 * sum(element.count for element in elements):
        raise Unreadable(f"{rest} values or bytes follow the last element that it announces; export it again")
    return _mesh(
        tables,
        [f"{many(rest, 'value or byte', 'values or bytes')} after the last element are not read"] if rest else [],
    )


def _mesh(tables: dict[str, _Table], notes: list[str]) -> MeshFile:
    if "vertex" not in tables or not {"x", "y", "z"} <= tables["vertex"].scalars.keys():
        raise Unreadable("its vertices have no x, y and z, so it holds no triangles; export it again")
    vertex = tables.pop("vertex").scalars
    points = np.column_stack([vertex["x"], vertex["y"], vertex["z"]])
    found = [np.empty((0, 3), np.int64)]
    if face := tables.pop("face", None):
        size, corners = _corners(face, "face", len(points))
        found.append(triangulated(points, size, corners))
        accounted("triangles", int(np.maximum(size - 2, 0).sum()), len(found[-1]))
        if thin := int((size < 3).sum()):
            notes.append(f"{many(thin, 'face')} of fewer than 3 corners have no area and are not taken")
    if strips := tables.pop("tristrips", None):
        size, corners = _corners(strips, "tristrips", len(points), least=-1)
        for part in np.split(corners, np.cumsum(size)[:-1]):
            for piece in np.split(part, np.flatnonzero(part < 0)):
                found.append(strip(piece[piece >= 0]))
    if "range_grid" in tables:
        raise Unreadable("it holds a range_grid, not triangles; export it as a mesh")
    notes += [f"its element {name} is not geometry that an arm touches" for name in sorted(tables)]
    triangles = np.concatenate(found)
    if not len(triangles):
        raise Unreadable("it holds no triangles, only points; export it as a mesh")
    return MeshFile(points[triangles], tuple(notes))


def _corners(table: _Table, name: str, count: int, least: int = 0) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    lists = [table.lists[key] for key in _LISTS if key in table.lists]
    if len(lists) != 1:
        raise Unreadable(f"its {name} have no list vertex_indices; export it again")
    size, values = lists[0]
    corners = values.astype(np.int64)
    if len(corners) and ((corners != values).any() or corners.min() < least or corners.max() >= count):
        raise Unreadable(f"one of its {name} names a vertex that is not among its {count}; export it again")
    return size, corners


def _header(content: bytes) -> tuple[str, list[_Element], int]:
    """The byte order, empty for text; the elements; and where they begin."""
    elements: list[_Element] = []
    order: str | None = None
    start = 0
    for number in range(1, 10_000):
        ends = [end for end in (content.find(b"\n", start), content.find(b"\r", start)) if end >= 0]
        if not ends:
            break
        line, after = content[start : min(ends)], min(ends) + 1
        if content[after - 1 : after + 1] == b"\r\n":
            after += 1
        start = after
        words = line.decode("latin-1").split()
        match words:
            case ["ply"] if number == 1:
                pass
            case _ if number == 1:
                break
            case [] | ["comment", *_] | ["obj_info", *_]:
                pass
            case ["format", kind, _] if kind in _ORDERS:
                order = _ORDERS[kind]
            case ["element", name, count] if count.isdecimal():
                elements.append(_Element(name, int(count)))
            case ["property", "list", length, kind, name] if elements and length in _TYPES and kind in _TYPES:
                elements[-1].properties.append(_Property(name, _TYPES[kind], _TYPES[length]))
            case ["property", kind, name] if elements and kind in _TYPES:
                elements[-1].properties.append(_Property(name, _TYPES[kind]))
            case ["end_header"]:
                if order is None:
                    raise Unreadable("its header does not state a format; export it again")
                return order, elements, start
            case _:
                raise Unreadable(f"line {number}: {shown(line)} is no line of a PLY header; export it again")
    raise Unreadable("it has no PLY header and holds no triangles; export it again")


class _Words:
    """Values of a text, one after the other. A line that begins with `comment` is none."""

    def __init__(self, body: bytes) -> None:
        if b"comment" in body:
            body = b"\n".join(line for line in body.splitlines() if not line.lstrip().startswith(b"comment"))
        self.values = np.array(list(map(float, body.split())))
        self.at = 0

    def take(self, count: int, types: list[str]) -> Column:
        """The values (count, len(types))."""
        many = count * len(types)
        if self.at + many > len(self.values):
            raise ValueError
        self.at += many
        return self.values[self.at - many : self.at].reshape(count, len(types))

    def peek(self, _: str) -> float:
        return float(self.values[self.at])

    def rest(self) -> int:
        """The number of values that are left."""
        return len(self.values) - self.at


class _Bytes:
    """Values of a binary file, one after the other."""

    def __init__(self, body: memoryview, order: str) -> None:
        self.body, self.order, self.at = body, order, 0

    def take(self, count: int, types: list[str]) -> Column:
        """The values (count, len(types))."""
        row = np.dtype([(str(at), self.order + one) for at, one in enumerate(types)])
        values = np.frombuffer(self.body, row, count, self.at) if count else np.empty(0, row)
        self.at += count * row.itemsize
        found = np.empty((count, len(types)))
        for at in range(len(types)):
            found[:, at] = values[str(at)]
        return found

    def peek(self, type_: str) -> float:
        return float(np.frombuffer(self.body, self.order + type_, 1, self.at)[0])

    def rest(self) -> int:
        """The number of bytes that are left."""
        return len(self.body) - self.at


def _table(element: _Element, reader: _Words | _Bytes) -> _Table:
    lists = [one for one in element.properties if one.length]
    if not lists:
        values = reader.take(element.count, [one.type for one in element.properties])
        return _Table({one.name: values[:, at] for at, one in enumerate(element.properties)}, {})
    start = reader.at
    found = _of_one_length(element, reader)
    if found is None:
        reader.at = start
        found = _of_any_length(element, reader)
    return found


def _of_one_length(element: _Element, reader: _Words | _Bytes) -> _Table | None:
    """The table, None unless all rows have lists as long as the first row's: most files are all triangles."""
    if not element.count:
        return _Table({}, {one.name: (np.empty(0, np.int64), np.empty(0)) for one in element.properties if one.length})
    start, types, lengths = reader.at, list[str](), list[int]()
    for one in element.properties:
        length = _length(reader.peek(one.length)) if one.length else 1
        types_here = [one.length or one.type] + [one.type] * length if one.length else [one.type]
        reader.take(1, types_here)
        types += types_here
        lengths.append(length)
    reader.at = start
    try:
        values = reader.take(element.count, types)
    except ValueError:
        return None
    table, at = _Table({}, {}), 0
    for one, length in zip(element.properties, lengths, strict=True):
        if one.length:
            if (values[:, at] != length).any():
                return None
            table.lists[one.name] = np.full(element.count, length), values[:, at + 1 : at + 1 + length].ravel()
            at += 1 + length
        else:
            table.scalars[one.name] = values[:, at]
            at += 1
    return table


def _of_any_length(element: _Element, reader: _Words | _Bytes) -> _Table:
    parts: dict[str, list[Column]] = {one.name: [] for one in element.properties}
    for _ in range(element.count):
        for one, length in _row(element, reader):
            parts[one.name].append(reader.take(1, [one.type] * length)[0])
    table = _Table({}, {})
    for one in element.properties:
        found = parts[one.name]
        values = np.concatenate(found)
        if one.length:
            table.lists[one.name] = np.array([len(part) for part in found], np.int64), values
        else:
            table.scalars[one.name] = values
    return table


def _row(element: _Element, reader: _Words | _Bytes) -> Iterator[tuple[_Property, int]]:
    """The properties of a row, and how many values each has."""
    for one in element.properties:
        yield one, _length(reader.take(1, [one.length])[0, 0]) if one.length else 1


def _length(value: float) -> int:
    if value < 0 or value != int(value):
        raise ValueError
    return int(value)
