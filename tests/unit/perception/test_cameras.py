"""A camera's images: where they were taken, and what is said of those that cannot be used."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pytest

import zarm
from zarm_contract.camera import DescribedCamera
from zarm_contract.errors import InvalidRequest
from zarm_contract.image import decode_image, encode_image
from zarm_contract.messages import Camera, CloudHeader, ImageHeader, JointState
from zarm_contract.robot import load_robot
from zarm_contract.section import read_section
from zarm_geometry.frames import matrix
from zarm_geometry.robot_model import RobotModel
from zarm_perception.cameras import CameraSource
from zarm_perception.joint_history import JointHistory
from zarm_perception.kernels.integration import directions

M1013 = RobotModel.of(load_robot("doosan_m1013"))
JOINTS = M1013.robot.descriptor.joints
HOME = np.array(M1013.robot.descriptor.home)
PIXELS = np.full((16, 32), 1500, "<u2")


def camera(link: str | None = None) -> Camera:
    pose = {"position": (0.1, 0.0, 0.2), "orientation": (0.0, 0.6, 0.0, 0.8)}
    return Camera(name="eye", link=link, width=32, height=16, fx=30.0, fy=30.0, cx=15.5, cy=7.5, **pose)


def payload(stamp: float, pixels: np.ndarray = PIXELS, encoding: str = "16UC1", width: int | None = None) -> bytes:
    header = ImageHeader(stamp=stamp, width=width or pixels.shape[1], height=pixels.shape[0], encoding=encoding)
    return encode_image(header, pixels.tobytes())


def state(stamp: float, *positions: float) -> JointState:
    return JointState(stamp=stamp, joint_names=JOINTS, position=positions, velocity=(0.0,) * 6)


@pytest.mark.parametrize(("pixels", "encoding"), [(PIXELS, "16UC1"), (PIXELS.astype("<f4") / 1000.0, "32FC1")])
def test_both_encodings_are_read_in_metres(pixels: np.ndarray, encoding: str) -> None:
    image = CameraSource(camera(), M1013).read(payload(time.time(), pixels, encoding))
    assert image is not None
    np.testing.assert_allclose(image.depth, 1.5)


def test_a_camera_on_a_link_moves_with_it() -> None:
    view = CameraSource(camera("link_6"), M1013).view(HOME)
    expected = M1013.fk_link("link_6", HOME) @ matrix((0.1, 0.0, 0.2), (0.0, 0.6, 0.0, 0.8))
    np.testing.assert_allclose(view.place, expected[:3, 3], atol=1e-12)
    np.testing.assert_allclose(view.turn, expected[:3, :3], atol=1e-12)
    assert CameraSource(camera("link_6"), M1013).moves
    assert not CameraSource(camera(), M1013).moves


def test_a_camera_on_a_link_that_is_not_there_is_refused() -> None:
    with pytest.raises(InvalidRequest, match="the robot has no link elbow"):
        CameraSource(camera("elbow"), M1013)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (lambda: b"\x00" * 2000, "begins with its header, a line of JSON"),
        (lambda: b"{}\n", "Field required"),
        (lambda: payload(time.time()) + b"more", "1028 bytes of pixels, where 32 x 16 of 16UC1 take 1024"),
        (lambda: payload(time.time(), np.zeros((16, 64), "<u2")), "64 x 16 pixels, where the camera eye has 32 x 16"),
        (lambda: payload(time.time() + 0.3), "in the future; make the clocks agree"),
        (lambda: payload(time.time() - 0.9), "s old (at most 0.5 s)"),
    ],
)
def test_an_image_that_cannot_be_used_is_refused_with_the_reason(content: object, words: str) -> None:
    assert callable(content)
    with pytest.raises(InvalidRequest) as caught:
        CameraSource(camera(), M1013).read(content())
    assert words in str(caught.value)


def test_an_image_that_comes_twice_or_late_counts_once() -> None:
    source, now = CameraSource(camera(), M1013), time.time()
    assert source.read(payload(now)) is not None
    assert source.read(payload(now)) is None
    assert source.read(payload(now - 0.1)) is None
    assert source.read(payload(now + 0.001)) is not None


def test_the_state_says_what_is_wrong() -> None:
    source = CameraSource(camera(), M1013)
    source.taken(0.8, 0.1, 0.004)
    assert source.state.problem == ""
    assert source.state.images == 1
    source.taken(0.01, 0.0, 0.004)
    assert source.state.problem == "only 1.0 % of its pixels have a depth: is it covered?"
    source.taken(0.9, 0.0, 0.004)
    assert source.state.problem == ""
    source.refused("the image is stamped 0.300 s in the future")
    assert "in the future" in source.state.problem


def test_header_and_pixels_come_back_as_they_went() -> None:
    header, pixels = decode_image(payload(12.5))
    assert (header.stamp, header.width, header.height) == (12.5, 32, 16)
    assert bytes(pixels) == PIXELS.tobytes()


def test_joints_are_interpolated_at_the_moment_of_an_image() -> None:
    history = JointHistory(JOINTS)
    history.receive("", state(10.0, *[0.0] * 6))
    history.receive("", state(10.1, *[1.0] * 6))
    middle = history.at(10.04)
    assert middle is not None
    np.testing.assert_allclose(middle, 0.4)
    assert history.at(10.12) is None, "where it has gone since is not known"
    assert history.at(9.99) is None
    history.receive("", state(10.3, *[1.3] * 6))
    assert history.at(10.2) is None, "it has moved, and nobody knows how"
    history.receive("", state(10.9, *[1.3] * 6))
    standing = history.at(10.5)
    assert standing is not None, "it has not moved"
    np.testing.assert_allclose(standing, 1.3)
    assert JointHistory(JOINTS).at(10.0) is None


def cloud(points: np.ndarray, stamp: float | None = None) -> bytes:
    found = points.astype("<f4")
    return encode_image(CloudHeader(stamp=stamp or time.time(), points=len(found)), found.tobytes())


def test_the_nearest_point_on_a_pixel_is_its_depth() -> None:
    source = CameraSource(camera(), M1013)
    # Pixel (u, v) = (20, 10) looks along ((20 - 15.5) / 30, (10 - 7.5) / 30, 1).
    ray = np.array([4.5 / 30.0, 2.5 / 30.0, 1.0])
    behind = [[np.nan, 0.0, 1.0], [0.0, 0.0, -1.0], [50.0, 0.0, 1.0]]
    image = source.read_cloud(cloud(np.array([2.0 * ray, 1.25 * ray, 1.5 * ray, *behind])))
    assert image is not None
    assert image.depth[10, 20] == pytest.approx(1.25)
    assert np.count_nonzero(image.depth) == 1


def test_points_of_a_lidar_are_ranges_all_around() -> None:
    per = 64 / (2.0 * np.pi)
    lidar = Camera(
        name="top", position=(0.0, 0.0, 1.0), projection="spherical",
        width=64, height=16, fx=per, fy=20.0, cx=31.5, cy=7.5,
    )  # fmt: skip
    source = CameraSource(lidar, M1013)
    view = source.view(HOME)
    image = source.read_cloud(cloud(np.array([[-2.0, 0.1, 0.0], [0.0, 1.5, 0.2]])))
    assert image is not None
    assert image.depth.shape == (16, 64 + 2 * view.seam)
    rows, columns = directions(view, *image.depth.shape)
    for v, u in np.argwhere(image.depth):
        away = image.depth[v, u]
        end = view.turn @ (rows[v, 0] * columns[u, 0], rows[v, 1], rows[v, 0] * columns[u, 1]) * away
        nearest = min(np.linalg.norm(end - point) for point in ([-2.0, 0.1, 0.0], [0.0, 1.5, 0.2]))
        assert nearest < 0.15, "in the middle of its pixel"
    assert np.count_nonzero(image.depth[:, view.seam : -view.seam]) == 2
    assert np.count_nonzero(image.depth) == 3, "what is behind it is on both sides"


@pytest.mark.parametrize(
    ("change", "why"),
    [
        ({"fx": None}, "the intrinsics are not complete: fx missing"),
        ({"fx": None, "topic": "/depth"}, "the intrinsics are not complete: fx missing"),
        ({"projection": "spherical", "fx": 2.0}, "it would see 917 by"),
    ],
)
def test_a_camera_that_cannot_be_is_refused(change: dict[str, object], why: str) -> None:
    with pytest.raises(InvalidRequest, match=why):
        CameraSource(camera().model_copy(update=change), M1013)


def test_a_camera_of_ros_may_wait_for_its_intrinsics() -> None:
    source = CameraSource(Camera(name="eye", position=(0.0, 0.0, 1.0), topic="/camera/depth"), M1013)
    assert "no camera_info came" in source.state.problem
    with pytest.raises(InvalidRequest, match="the intrinsics of the camera eye are not known"):
        source.read(payload(time.time()))


def described(folder: Path, text: str) -> Camera:
    file = folder / "eye.yaml"
    file.write_text(text + "width: 32\nheight: 16\nfx: 30\nfy: 30\ncx: 15.5\ncy: 7.5\n", encoding="utf-8")
    return read_section(file, "a camera", DescribedCamera)[1].message("eye")


def test_a_camera_looks_where_its_file_says(tmp_path: Path) -> None:
    eye = described(tmp_path, "position: [1.0, 0.5, 0.8]\nlook_at: [0.2, 0.1, 0.1]\n")
    assert eye.intrinsics
    same = zarm.Camera("eye", position=eye.position, look_at=(0.2, 0.1, 0.1), **eye.intrinsics._asdict())
    assert eye.model_dump() == same.model_dump()
    along = np.subtract((0.2, 0.1, 0.1), eye.position)
    turn = matrix(eye.position, eye.orientation)[:3, :3]
    np.testing.assert_allclose(turn[:, 2], along / np.linalg.norm(along), atol=1e-9)
    assert turn[2, 0] == pytest.approx(0.0)
    assert turn[2, 1] < 0.0


@pytest.mark.parametrize(
    "text",
    [
        "look_at: [1.0, 0.5, 0.8]\n",
        "look_at: [0.2, 0.1, 0.1]\norientation: [0, 0, 0, 1]\n",
        "look_at: [0.2, 0.1, 0.1]\nprojection: spherical\n",
    ],
)
def test_a_camera_that_looks_nowhere_is_refused(text: str, tmp_path: Path) -> None:
    with pytest.raises(InvalidRequest, match="look"):
        described(tmp_path, "position: [1.0, 0.5, 0.8]\n" + text)
