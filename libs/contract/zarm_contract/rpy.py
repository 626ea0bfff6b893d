"""Roll, pitch and yaw of an orientation, as URDF writes them."""

from __future__ import annotations

import math

from zarm_contract.messages import Quaternion, Vector3

_UPRIGHT = 1e-9


def rpy_of(orientation: Quaternion) -> Vector3:
    """Roll, pitch and yaw (rad) of a quaternion: R = Rz(yaw) Ry(pitch) Rx(roll). Where the pitch is a quarter turn, the yaw is 0."""
    x, y, z, w = orientation
    xx, yx, zx = 1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + z * w), 2.0 * (x * z - y * w)
    level = math.hypot(xx, yx)
    pitch = math.atan2(-zx, level)
    if level < _UPRIGHT:
        return math.atan2(2.0 * (x * w - y * z), 1.0 - 2.0 * (x * x + z * z)), pitch, 0.0
    return math.atan2(2.0 * (y * z + x * w), 1.0 - 2.0 * (x * x + y * y)), pitch, math.atan2(yx, xx)
