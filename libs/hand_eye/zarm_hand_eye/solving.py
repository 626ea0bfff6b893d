"""From views of a board to the pose of the camera: a closed form first, then least squares of the errors in the images.

The closed form is Park and Martin, "Robot sensor calibration: solving AX = XB on the Euclidean group", 1994.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from zarm_contract.messages import Intrinsics
from zarm_hand_eye.board import View
from zarm_trajectory.arrays import Array


@dataclass(frozen=True)
class Solution:
    """The camera (4, 4) in the frame that it is fixed to, and the board (4, 4) in the frame that this one is fixed to.

    `reprojection_error` is the RMS distance (pixels) of the corners from where they should be; `position_std` (m) and `angle_std` (rad) are the standard deviations of
    the camera's pose that follow from it.
    """

    camera: Array
    board: Array
    reprojection_error: float
    position_std: float
    angle_std: float


def solve(places: Sequence[Array], views: Sequence[View], intrinsics: Intrinsics) -> Solution:
    """The camera that saw `views` of one board while its mount was at `places`, (4, 4) in a frame in which the board stands still. Give at least three of them, turned about
    different axes.
    """
    turn, place = cv2.calibrateHandEye(
        [mount[:3, :3] for mount in places],
        [mount[:3, 3] for mount in places],
        [view.board[:3, :3] for view in views],
        [view.board[:3, 3] for view in views],
        method=cv2.CALIB_HAND_EYE_PARK,
    )
    camera = np.eye(4)
    camera[:3, :3], camera[:3, 3] = turn, place.ravel()
    board = places[0] @ camera @ views[0].board
    inward = [np.linalg.inv(mount) for mount in places]

    def errors(state: Array) -> Array:
        outward, there = np.linalg.inv(_moved(camera, state[:6])), _moved(board, state[6:])
        return np.concatenate(
            [
                (_projected(outward @ mount @ there, view.points, intrinsics) - view.pixels).ravel()
                for mount, view in zip(inward, views, strict=True)
            ]
        )

    found = least_squares(errors, np.zeros(12), method="lm", x_scale="jac")
    freedom = len(found.fun) - 12
    covariance = np.linalg.inv(found.jac.T @ found.jac) * (found.fun @ found.fun) / freedom
    spread = np.diag(covariance)
    return Solution(
        camera=_moved(camera, found.x[:6]),
        board=_moved(board, found.x[6:]),
        reprojection_error=float(np.sqrt(2.0 * np.mean(found.fun**2))),
        position_std=float(np.sqrt(spread[3:6].sum())),
        angle_std=float(np.sqrt(spread[:3].sum())),
    )


def _moved(frame: Array, by: Array) -> Array:
    """A frame (4, 4), turned by a rotation vector and moved, (6,), in its own axes."""
    step = np.eye(4)
    step[:3, :3], step[:3, 3] = Rotation.from_rotvec(by[:3]).as_matrix(), by[3:]
    return np.asarray(frame @ step)


def _projected(board: Array, points: Array, intrinsics: Intrinsics) -> Array:
    """Pixels (n, 2) of points (n, 3) of a board (4, 4) in the camera's frame."""
    x, y, z = (points @ board[:3, :3].T + board[:3, 3]).T
    return np.column_stack((intrinsics.fx * x / z + intrinsics.cx, intrinsics.fy * y / z + intrinsics.cy))
