"""Depth images on the page."""

from __future__ import annotations

import numpy as np
import pytest

import zarm
from zarm_contract.errors import InvalidRequest
from zarm_contract.image import COUNTS, OF_ROBOT, encode_image
from zarm_contract.messages import ImageHeader
from zarm_viewer.camera_view import NOISE, POINTS, ROBOT, UNKNOWN, cloud, shaded, thinned

CAMERA = zarm.Camera(
    "eye", position=(0, 0, 1), look_at=(1, 0, 0), width=640, height=480, fx=600.0, fy=600.0, cx=319.5, cy=239.5
)
HEADER = ImageHeader(stamp=0.0, width=640, height=480, encoding="16UC1")


@pytest.fixture
def depth() -> np.ndarray:
    """Near on the left, far on the right, nothing above (mm)."""
    depth = np.full((480, 640), 3000, "<u2")
    depth[:, :320] = 500
    depth[:240] = 0
    return depth


def test_near_is_light_and_unknown_has_its_own_colour(depth: np.ndarray) -> None:
    every = np.full((120, 160), COUNTS, np.uint8)
    image = shaded(thinned(encode_image(HEADER, depth.tobytes())), every, CAMERA)
    assert image.shape == (120, 160, 3)
    assert tuple(image[0, 0]) == UNKNOWN
    near, far = image[-1, 0], image[-1, -1]
    assert near.min() > far.max() + 100
    floats = encode_image(HEADER.model_copy(update={"encoding": "32FC1"}), (depth / 1000.0).astype("<f4").tobytes())
    np.testing.assert_allclose(image.astype(int), shaded(thinned(floats), every, CAMERA).astype(int), atol=1)


def test_the_robot_and_noise_are_coloured(depth: np.ndarray) -> None:
    metres, mask = thinned(encode_image(HEADER, depth.tobytes())), np.full((120, 160), COUNTS, np.uint8)
    mask[-1, 0], mask[-1, 1] = OF_ROBOT, 0
    image = shaded(metres, mask, CAMERA)
    assert len({*image[-1, 0].tolist()}) > 1, "the robot is not grey"
    assert len({*image[-1, 1].tolist()}) == 1
    assert CAMERA.intrinsics is not None
    points, colours = cloud(metres, mask, CAMERA.intrinsics, CAMERA.far, 4)
    assert len(points) == np.count_nonzero(metres)
    robot, noise, rest = points[-160], points[-159], points[-1]
    assert tuple(colours[-160]) == ROBOT
    assert tuple(colours[-159]) == NOISE
    assert tuple(colours[-1]) == POINTS
    np.testing.assert_allclose(robot, [-319.5 / 600 * 0.5, (476 - 239.5) / 600 * 0.5, 0.5], atol=1e-6)
    np.testing.assert_allclose(noise - robot, [4 / 600 * 0.5, 0.0, 0.0], atol=1e-6)
    np.testing.assert_allclose(rest, [(636 - 319.5) / 600 * 3.0, (476 - 239.5) / 600 * 3.0, 3.0], atol=1e-6)


def test_what_is_no_image_is_refused() -> None:
    with pytest.raises(InvalidRequest):
        thinned(b"{}")
