"""What cameras see of the links: their visual meshes, where there are."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from functools import cache
from pathlib import Path

import numpy as np

from zarm_geometry.visual_meshes import visual_meshes
from zarm_trajectory.arrays import Array

log = logging.getLogger(__name__)

_MAX_TRIANGLES = 200_000
"""Most triangles of a link that are rendered."""


@cache
def looks_of(urdf: Path) -> Mapping[str, Array]:
    """The triangles (n, 3, 3) in m of each link that has visual meshes, in its frame; read once, for every world that the robot is in."""
    looks: dict[str, Array] = {}
    for link, meshes in visual_meshes(urdf).items():
        try:
            triangles = np.concatenate([mesh.triangles() for mesh in meshes])
        except (ValueError, OSError) as error:
            log.warning("visual mesh not rendered link=%s reason=%s", link, error)
            continue
        if 0 < len(triangles) <= _MAX_TRIANGLES:
            looks[link] = triangles
        else:
            log.warning(
                "visual mesh not rendered link=%s triangles=%d largest=%d", link, len(triangles), _MAX_TRIANGLES
            )
    return looks
