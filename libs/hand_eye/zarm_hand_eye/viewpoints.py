"""From where a camera should see a board: turned about many axes, and the whole board in the image."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.spatial.transform import Rotation

from zarm_contract.messages import Intrinsics
from zarm_hand_eye.board import Board
from zarm_trajectory.arrays import Array

_TILT = (0.17, 0.6)
"""rad between the first direction of view and others."""
_ROLL = 1.0
"""rad about the direction of view, to each side."""
_DISTANCE = (0.85, 1.2)
"""Of the first distance."""
_AIM = 0.15
"""How far the middle of the board may be from that of the image, as a share of the image."""


def viewpoints(first: Array, board: Board, intrinsics: Intrinsics, seed: int) -> Iterator[Array]:
    """Without end: a board (4, 4) in the camera's frame, around the `first` view of it."""
    random = np.random.default_rng(seed)
    middle = np.array([0.5 * board.size[0], 0.5 * board.size[1], 0.0])
    camera = np.linalg.inv(first)
    away = camera[:3, 3] - middle
    while True:
        tilt = Rotation.from_rotvec(random.uniform(*_TILT) * _across(away, random))
        place = middle + random.uniform(*_DISTANCE) * tilt.apply(away)
        forward = middle - place
        forward /= np.linalg.norm(forward)
        right = tilt.apply(camera[:3, 0])
        right -= (right @ forward) * forward
        right /= np.linalg.norm(right)
        looking = np.column_stack((right, np.cross(forward, right), forward))
        roll = Rotation.from_rotvec([0.0, 0.0, random.uniform(-_ROLL, _ROLL)])
        u, v = random.uniform(-_AIM, _AIM, 2) * (intrinsics.width / intrinsics.fx, intrinsics.height / intrinsics.fy)
        aside = Rotation.from_rotvec([v, -u, 0.0])
        seen = np.eye(4)
        seen[:3, :3], seen[:3, 3] = looking @ (roll * aside).as_matrix(), place
        yield np.asarray(np.linalg.inv(seen), np.float64)


def _across(direction: Array, random: np.random.Generator) -> Array:
    """A random unit vector at a right angle to a direction."""
    found = np.cross(direction, random.normal(size=3))
    return np.asarray(found / np.linalg.norm(found))
