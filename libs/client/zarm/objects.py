"""Objects of the scene, made as the values of `zarm.values` are."""

from __future__ import annotations

import sys
from array import array
from base64 import b64encode
from collections.abc import Sequence
from itertools import chain
from pathlib import Path as FilePath
from typing import TYPE_CHECKING, Any

from zarm.values import IDENTITY, Checked, numbers, rows
from zarm_contract import messages
from zarm_contract.errors import InvalidRequest

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

    from zarm.values import Numbers, Rows


class Cuboid(Checked, messages.Cuboid):
    """A box; `size` are the full edge lengths (m) along its own x, y, z, `position` is its centre."""

    def __init__(self, name: str, *, size: Numbers, position: Numbers, orientation: Numbers = IDENTITY) -> None:
        super().__init__(**_placed("cuboid", name, position, orientation), size=numbers(size, "size"))


class Sphere(Checked, messages.Sphere):
    """A ball of `radius` (m) around `position`."""

    def __init__(self, name: str, *, radius: float, position: Numbers) -> None:
        super().__init__(kind="sphere", name=name, position=numbers(position, "position"), radius=radius)


class Capsule(Checked, messages.Capsule):
    """All points within `radius` (m) of a segment of `length` (m) along its own z, centred at `position`."""

    def __init__(
        self, name: str, *, radius: float, length: float, position: Numbers, orientation: Numbers = IDENTITY
    ) -> None:
        super().__init__(**_placed("capsule", name, position, orientation), radius=radius, length=length)


class Cylinder(Checked, messages.Cylinder):
    """A cylinder with flat ends, `length` (m) along its own z, centred at `position`."""

    def __init__(
        self, name: str, *, radius: float, length: float, position: Numbers, orientation: Numbers = IDENTITY
    ) -> None:
        super().__init__(**_placed("cylinder", name, position, orientation), radius=radius, length=length)


class Mesh(Checked, messages.Mesh):
    """Triangles of an STL or OBJ `file`, a path inside one of the planner's mesh folders; a closed mesh is solid.

    `scale` multiplies the file's coordinates to make them m: one number, or one for each axis; 0.001 for mm. With `data`, the content of the
    file, the planner needs no file of this name.
    """

    def __init__(
        self,
        name: str,
        *,
        file: str | FilePath,
        position: Numbers,
        orientation: Numbers = IDENTITY,
        scale: float | Numbers = 1.0,
        data: bytes | str | None = None,
        sha256: str | None = None,
    ) -> None:
        factors = (float(scale),) * 3 if isinstance(scale, int | float) else numbers(scale, "scale")
        super().__init__(
            **_placed("mesh", name, position, orientation),
            file=str(file),
            scale=factors,
            data=b64encode(data).decode() if isinstance(data, bytes) else data,
            sha256=sha256,
        )


class Voxels(Checked, messages.Voxels):
    """Occupied cubes with edges of `resolution` m: cell (i, j, k) has its centre at (i, j, k) * `resolution`.

    `cells` are whole numbers (n, 3); `position` and `orientation` place the grid.
    """

    def __init__(
        self,
        name: str,
        *,
        resolution: float,
        cells: Sequence[Sequence[int]] | npt.NDArray[np.integer[Any]],
        position: Numbers = (0.0, 0.0, 0.0),
        orientation: Numbers = IDENTITY,
    ) -> None:
        whole = tuple(tuple(map(int, cell)) for cell in cells)
        super().__init__(**_placed("voxels", name, position, orientation), resolution=resolution, cells=whole)


_LISTED = 10_000
"""Most points of a cloud that are sent as a list, which people can read."""


def _packed(points: Sequence[Sequence[float]]) -> str:
    """Points as `messages.PointCloud` packs them. Raises InvalidRequest for rows of other lengths than 3."""
    if any(len(point) != 3 for point in points):
        raise InvalidRequest("each point has three coordinates", field="points")
    found = array("d", chain.from_iterable(points))
    if sys.byteorder == "big":
        found.byteswap()
    return b64encode(found).decode()


class PointCloud(Checked, messages.PointCloud):
    """Points (n, 3) in m that are obstacles; the scene keeps the voxels of `resolution` m that they lie in.

    `position` and `orientation` are those of the frame of the points.
    """

    def __init__(
        self,
        name: str,
        points: Rows,
        *,
        resolution: float = 0.02,
        position: Numbers = (0.0, 0.0, 0.0),
        orientation: Numbers = IDENTITY,
    ) -> None:
        listed = rows(points, "points")
        content = listed if len(listed) <= _LISTED else _packed(listed)
        super().__init__(**_placed("cloud", name, position, orientation), resolution=resolution, points=content)


def object_of(item: messages.SceneObject) -> messages.SceneObject:
    """An object from a message, as the matching class of this module."""
    made: messages.SceneObject = _CLASSES[item.kind].model_construct(
        **{name: getattr(item, name) for name in type(item).model_fields}
    )
    return made


def _placed(kind: str, name: str, position: Numbers, orientation: Numbers) -> dict[str, object]:
    return {
        "kind": kind,
        "name": name,
        "position": numbers(position, "position"),
        "orientation": numbers(orientation, "orientation"),
    }


_CLASSES: dict[str, type[Any]] = {
    "cuboid": Cuboid,
    "sphere": Sphere,
    "capsule": Capsule,
    "cylinder": Cylinder,
    "mesh": Mesh,
    "voxels": Voxels,
}
