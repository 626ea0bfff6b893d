"""A click in the picture hits what is drawn there."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
import viser

import zarm
from support.viewer import free_port
from zarm_contract.messages import SceneObject
from zarm_viewer.drawing import Brush, draw_object
from zarm_viewer.picking import distance

TURNED = (0.0, 0.0, float(np.sin(np.pi / 8)), float(np.cos(np.pi / 8)))
DOWN = np.array((0.0, 0.0, -1.0))


@pytest.fixture(scope="module")
def brush() -> Iterator[Brush]:
    server = viser.ViserServer(host="127.0.0.1", port=free_port(), verbose=False)
    yield Brush(server.scene, (0, 0, 0))
    server.stop()


@pytest.mark.parametrize(
    ("item", "top"),
    [
        (zarm.Cuboid("box", size=(0.2, 0.2, 0.2), position=(0.5, 0.1, 0.3), orientation=TURNED), 0.4),
        (zarm.Sphere("ball", radius=0.1, position=(0.5, 0.1, 0.3)), 0.4),
        (zarm.Voxels("cloud", resolution=0.02, cells=[(25, 5, 15), (25, 5, 20)]), 0.4),
    ],
)
def test_a_ray_hits_the_near_side_or_misses(brush: Brush, item: SceneObject, top: float) -> None:
    drawn = draw_object(brush, f"/{item.name}", item, ())
    assert drawn is not None
    above = np.array((0.503, 0.104, 1.0))
    assert distance(above, DOWN, drawn) == pytest.approx(1.0 - top, abs=2e-3)
    assert distance(above, -DOWN, drawn) == np.inf
    assert distance(above + (0.2, 0.0, 0.0), DOWN, drawn) == np.inf
