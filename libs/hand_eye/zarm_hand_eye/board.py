"""A printed ChArUco board: a chessboard whose white squares carry markers."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from zarm_contract.errors import InvalidRequest
from zarm_contract.messages import Intrinsics
from zarm_trajectory.arrays import Array

_PIXELS = 100
"""Pixels along the edge of a square of the picture to print."""
_MIN_CORNERS = 8
"""Corners of the chessboard without which a view does not count."""


@dataclass(frozen=True)
class View:
    """The corners that were found of a board: where they are on it (n, 3) in m, in the image (n, 2) in pixels, and the board (4, 4) in the camera's frame."""

    points: Array
    pixels: Array
    board: Array


@dataclass(frozen=True)
class Board:
    """A ChArUco board of OpenCV, of `columns` by `rows` squares with edges of `square` (m), whose markers, with edges of `marker` (m), are of an ArUco
    `dictionary`. The default fits on A4.

    Its frame is in a corner, x along the rows, y along the columns. Raises InvalidRequest where there is no such board.
    """

    columns: int = 7
    rows: int = 5
    square: float = 0.04
    marker: float = 0.03
    dictionary: str = "DICT_4X4_50"

    def __post_init__(self) -> None:
        if self.columns < 3 or self.rows < 3:
            raise InvalidRequest(
                f"a board of {self.columns} by {self.rows} squares has too few corners; use 3 by 3 or more",
                field="columns",
            )
        if not 0.0 < self.marker < self.square:
            raise InvalidRequest(
                f"markers of {self.marker:g} m do not fit into squares of {self.square:g} m", field="marker"
            )
        if not hasattr(cv2.aruco, self.dictionary):
            raise InvalidRequest(
                f"OpenCV has no dictionary {self.dictionary}; such as DICT_4X4_50, DICT_5X5_100", field="dictionary"
            )
        markers = self.columns * self.rows // 2
        if markers > (known := len(self._markers.bytesList)):
            raise InvalidRequest(
                f"{self.dictionary} has {known} markers, and this board takes {markers}; use a larger one",
                field="dictionary",
            )

    @property
    def size(self) -> tuple[float, float]:
        """Width and height (m)."""
        return self.columns * self.square, self.rows * self.square

    def picture(self) -> bytes:
        """The board as a PNG file, to print `size` large."""
        drawn = self._charuco.generateImage((_PIXELS * self.columns, _PIXELS * self.rows))
        return bytes(cv2.imencode(".png", drawn)[1])

    def find(self, image: NDArray[np.uint8], intrinsics: Intrinsics) -> View | None:
        """The board in an image (h, w) or (h, w, 3); None where too little of it is seen."""
        grey = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
        corners, ids, _, _ = self._detector.detectBoard(grey)
        if ids is None or len(ids) < _MIN_CORNERS:
            return None
        points = np.asarray(self._charuco.getChessboardCorners(), np.float64)[ids.ravel()]
        pixels = np.asarray(corners, np.float64).reshape(-1, 2)
        found, turn, place = cv2.solvePnP(points, pixels, camera_matrix(intrinsics), None, flags=cv2.SOLVEPNP_IPPE)
        if not found:
            return None
        board = np.eye(4)
        board[:3, :3], board[:3, 3] = cv2.Rodrigues(turn)[0], place.ravel()
        return View(points, pixels, board)

    @cached_property
    def _markers(self) -> Any:
        return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, self.dictionary))

    @cached_property
    def _charuco(self) -> Any:
        return cv2.aruco.CharucoBoard((self.columns, self.rows), self.square, self.marker, self._markers)

    @cached_property
    def _detector(self) -> Any:
        return cv2.aruco.CharucoDetector(self._charuco)


def camera_matrix(intrinsics: Intrinsics) -> Array:
    """The camera matrix (3, 3)."""
    return np.array([[intrinsics.fx, 0.0, intrinsics.cx], [0.0, intrinsics.fy, intrinsics.cy], [0.0, 0.0, 1.0]])
