"""The voxel map on the page: what has just been seen stands out."""

from __future__ import annotations

import math

import numpy as np

from zarm_viewer.voxel_view import FADES, NEW, OLD, colours


def test_a_voxel_fades_with_its_age() -> None:
    found = colours(np.array([100.0, 100.0 - FADES / 2, 100.0 - FADES, -math.inf]), 100.0)
    assert tuple(found[0]) == NEW
    assert tuple(found[2]) == tuple(found[3]) == OLD
    np.testing.assert_allclose(found[1], (np.array(NEW) + OLD) / 2, atol=1)
