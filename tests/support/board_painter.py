"""A camera that sees a calibration board, as it would from where the robot is: images warped from the board's picture."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import cv2
import numpy as np
from numpy.typing import NDArray

from zarm.robot import Robot
from zarm_contract.messages import Intrinsics
from zarm_hand_eye import Board
from zarm_hand_eye.board import camera_matrix
from zarm_trajectory.arrays import Array

_PERIOD = 0.1
_FAR = 3000
"""mm; outside of the voxel map."""


@contextmanager
def painted(robot: Robot, camera: str, paint: Callable[[Array], NDArray[np.uint8]]) -> Iterator[None]:
    """Publish the images `paint(joints)` of a camera ten times a second, and depths of what is far away."""
    ended = threading.Event()

    def run() -> None:
        while not ended.wait(_PERIOD):
            stamp, joints = time.time(), np.array(robot.joint_state().position)
            image = paint(joints)
            height, width = image.shape
            robot.perception.publish_color(camera, stamp, image)
            robot.perception.publish(
                camera, stamp, np.full(image.shape, _FAR, "<u2").tobytes(), width=width, height=height
            )

    painter = threading.Thread(target=run)
    painter.start()
    try:
        yield
    finally:
        ended.set()
        painter.join()


def image_of(board: Board, intrinsics: Intrinsics, seen: Array) -> NDArray[np.uint8]:
    """A grey image of the board (4, 4) in the camera's frame, on a grey table."""
    picture = cv2.imdecode(np.frombuffer(board.picture(), np.uint8), cv2.IMREAD_GRAYSCALE)
    scale = board.size[0] / picture.shape[1]
    # A pixel's middle is half a pixel from the edge of the picture.
    on_board = np.array([[scale, 0.0, 0.5 * scale], [0.0, scale, 0.5 * scale], [0.0, 0.0, 1.0]])
    onto = camera_matrix(intrinsics) @ seen[:3, [0, 1, 3]] @ on_board
    fine = np.diag([4.0, 4.0, 1.0]) + np.array(
        [[0.0, 0.0, 1.5], [0.0, 0.0, 1.5], [0.0, 0.0, 0.0]]
    )  # drawn four times as fine
    drawn = cv2.warpPerspective(
        picture, fine @ onto, (4 * intrinsics.width, 4 * intrinsics.height), borderValue=(128.0,), flags=cv2.INTER_AREA
    )
    return np.asarray(cv2.resize(drawn, (intrinsics.width, intrinsics.height), interpolation=cv2.INTER_AREA), np.uint8)
