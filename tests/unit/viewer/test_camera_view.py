"""Depth images on the page."""

from __future__ import annotations

import numpy as np
import pytest

import zarm
from zarm_contract.errors import InvalidRequest
from zarm_contract.image import encode_image
from zarm_contract.messages import ImageHeader
from zarm_viewer.camera_view import UNKNOWN, shaded

CAMERA = zarm.Camera(
    "eye", position=(0, 0, 1), look_at=(1, 0, 0), width=640, height=480, fx=600.0, fy=600.0, cx=319.5, cy=239.5
)


def test_what_is_near_is_light_and_what_is_not_known_has_a_colour_of_its_own() -> None:
    depth = np.full((480, 640), 3000, "<u2")
    depth[:, :320] = 500
    depth[:240] = 0
    header = ImageHeader(stamp=0.0, width=640, height=480, encoding="16UC1")
    image = shaded(encode_image(header, depth.tobytes()), CAMERA)
    assert image.shape == (120, 160, 3)
    assert tuple(image[0, 0]) == UNKNOWN
    near, far = image[-1, 0], image[-1, -1]
    assert near.min() > far.max() + 100
    metres = shaded(encode_image(header.model_copy(update={"encoding": "32FC1"}), (depth / 1000.0).astype("<f4").tobytes()), CAMERA)  # fmt: skip
    np.testing.assert_allclose(image.astype(int), metres.astype(int), atol=1)


def test_what_is_no_image_is_refused() -> None:
    with pytest.raises(InvalidRequest):
        shaded(b"{}", CAMERA)
