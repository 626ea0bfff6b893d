"""A camera follows from views of a board, however noisy, as well as it says; and faults of a board are named."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from support.board_painter import image_of
from zarm_contract.errors import InvalidRequest
from zarm_contract.messages import Intrinsics
from zarm_hand_eye import Board
from zarm_hand_eye.board import View
from zarm_hand_eye.solving import Solution, solve
from zarm_hand_eye.viewpoints import viewpoints
from zarm_trajectory.arrays import Array

SIZE = Intrinsics(640, 480, 600.0, 610.0, 322.0, 237.0)
BOARD = Board()
CORNERS = np.array([(0.04 * i, 0.04 * j, 0.0) for j in range(1, 5) for i in range(1, 7)])


def frame(random: np.random.Generator) -> Array:
    made = np.eye(4)
    made[:3, :3], made[:3, 3] = Rotation.random(random_state=random.integers(2**31)).as_matrix(), random.normal(size=3)
    return made


def first_view() -> Array:
    """The board half a metre before the camera, a bit turned."""
    seen = np.eye(4)
    seen[:3, :3], seen[:3, 3] = Rotation.from_rotvec([0.2, -0.1, 0.3]).as_matrix(), (-0.12, -0.1, 0.5)
    return seen


def solved(seed: int, noise: float, count: int = 15) -> tuple[Solution, Array]:
    """The solution from views with so much noise (pixels), and the camera as it is."""
    random = np.random.default_rng(seed)
    camera, board, places, views = frame(random), frame(random), [], []
    for _, seen in zip(range(count), viewpoints(first_view(), BOARD, SIZE, seed), strict=False):
        x, y, z = (CORNERS @ seen[:3, :3].T + seen[:3, 3]).T
        pixels = np.column_stack((SIZE.fx * x / z + SIZE.cx, SIZE.fy * y / z + SIZE.cy))
        views.append(View(CORNERS, pixels + random.normal(scale=noise, size=pixels.shape), seen))
        places.append(board @ np.linalg.inv(seen) @ np.linalg.inv(camera))
    return solve(places, views, SIZE), camera


@pytest.mark.parametrize("seed", range(5))
def test_without_noise_the_camera_is_found_exactly(seed: int) -> None:
    solution, camera = solved(seed, 0.0)
    np.testing.assert_allclose(solution.camera, camera, atol=1e-7)
    assert solution.reprojection_error < 1e-5


def test_with_noise_the_camera_is_as_near_as_the_solution_says() -> None:
    """Over many calibrations the errors have the size that each of them states."""
    shares = []
    for seed in range(30):
        solution, camera = solved(seed, 0.3)
        shares.append(np.linalg.norm(solution.camera[:3, 3] - camera[:3, 3]) / solution.position_std)
        turn = Rotation.from_matrix(solution.camera[:3, :3].T @ camera[:3, :3]).magnitude()
        shares.append(turn / solution.angle_std)
        assert solution.reprojection_error == pytest.approx(0.3 * np.sqrt(2.0), rel=0.15)
    assert 0.7 < np.sqrt(np.mean(np.square(shares))) < 1.4


def test_every_viewpoint_sees_the_board_and_axes_differ() -> None:
    axes = []
    for _, seen in zip(range(100), viewpoints(first_view(), BOARD, SIZE, 0), strict=False):
        x, y, z = (CORNERS @ seen[:3, :3].T + seen[:3, 3]).T
        assert (z > 0.3).all()
        u, v = SIZE.fx * x / z + SIZE.cx, SIZE.fy * y / z + SIZE.cy
        assert ((u > 0) & (u < 639) & (v > 0) & (v < 479)).all()
        axes.append(Rotation.from_matrix(seen[:3, :3]).as_rotvec())
    assert np.linalg.svd(np.array(axes) - np.mean(axes, axis=0))[1][-1] > 1.0


def test_a_board_is_found_in_an_image_where_it_is() -> None:
    view = BOARD.find(image_of(BOARD, SIZE, first_view()), SIZE)
    assert view is not None
    np.testing.assert_allclose(view.board, first_view(), atol=2e-3)
    assert BOARD.find(np.zeros((480, 640), np.uint8), SIZE) is None


@pytest.mark.parametrize(
    ("fields", "field", "words"),
    [
        ({"columns": 2}, "columns", "too few corners"),
        ({"marker": 0.05}, "marker", "do not fit into squares of 0.04 m"),
        ({"dictionary": "DICT_9"}, "dictionary", "OpenCV has no dictionary DICT_9"),
        ({"columns": 20, "rows": 20}, "dictionary", "has 50 markers, and this board takes 200"),
    ],
)
def test_a_board_that_cannot_be_is_refused_by_field(fields: dict[str, object], field: str, words: str) -> None:
    with pytest.raises(InvalidRequest, match=words) as caught:
        Board(**fields)  # type: ignore[arg-type]
    assert caught.value.problem.field == field
