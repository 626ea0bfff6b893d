"""Things in a voxel map, as boxes."""

from __future__ import annotations

from collections.abc import Sequence

from zarm_contract.errors import Unavailable
from zarm_contract.messages import Cuboid, Vector3

_MIN_VOXELS = 3
"""Fewer voxels than these are noise."""
_TURNS = 36
"""Ways to turn a box between which the smallest is chosen, over a right angle."""


def boxes_around(
    points: Sequence[Vector3], resolution: float, largest: float, floor: float | None, prefix: str
) -> list[Cuboid]:
    """Axis-aligned upright boxes around clusters of voxels, largest first; the voxels are given by their centres (m)."""
    try:
        import numpy as np
        from scipy import ndimage
    except ImportError as error:
        raise Unavailable("boxes need SciPy; `pip install 'zarm[planner]'` installs it") from error
    if not points:
        return []
    centers = np.array(points)
    cells = np.rint((centers - centers.min(axis=0)) / resolution).astype(int)
    volume = np.zeros(cells.max(axis=0) + 1, bool)
    volume[tuple(cells.T)] = True
    labels, count = ndimage.label(volume, np.ones((3, 3, 3)))  # neighbours over edges and corners too
    cluster = labels[tuple(cells.T)]
    turns = np.linspace(0.0, np.pi / 2.0, _TURNS, endpoint=False)
    axes = np.stack((np.cos(turns), np.sin(turns), -np.sin(turns), np.cos(turns)), axis=1).reshape(-1, 2, 2)
    found: list[tuple[int, Cuboid]] = []
    for label in range(1, count + 1):
        members = centers[cluster == label]
        along = axes @ members[:, :2].T  # (turns, 2, members)
        low, high = along.min(axis=2), along.max(axis=2)
        best = int(np.argmin(np.prod(high - low + resolution, axis=1)))
        width, depth = (high - low)[best] + resolution
        bottom, top = members[:, 2].min() - resolution / 2.0, members[:, 2].max() + resolution / 2.0
        bottom = bottom if floor is None else min(floor, bottom)
        if len(members) < _MIN_VOXELS or max(width, depth, top - bottom) > largest:
            continue
        x, y = 0.5 * (low + high)[best] @ axes[best]
        half = 0.5 * turns[best]
        box = Cuboid(
            kind="cuboid",
            name=prefix,
            position=(float(x), float(y), float(0.5 * (bottom + top))),
            orientation=(0.0, 0.0, float(np.sin(half)), float(np.cos(half))),
            size=(float(width), float(depth), float(top - bottom)),
        )
        found.append((len(members), box))
    found.sort(key=lambda pair: -pair[0])
    return [box.model_copy(update={"name": f"{prefix}_{n}"}) for n, (_, box) in enumerate(found)]
