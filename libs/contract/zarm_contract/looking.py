"""Where a camera looks, as an orientation."""

from __future__ import annotations

import math
from collections.abc import Sequence

from zarm_contract.messages import Quaternion

_PARALLEL_TOLERANCE = 1e-9


def looking(eye: Sequence[float], at: Sequence[float]) -> Quaternion:
    """The orientation of an optical frame at `eye` (3,) that looks at a point (3,), its y as far down as possible. Raises ValueError for the same point, or none."""
    if len(at) != 3 or len(eye) != 3:
        raise ValueError("a point has three coordinates: x, y and z in m")
    along = [there - here for there, here in zip(at, eye, strict=True)]
    length = math.hypot(*along)
    if length < _PARALLEL_TOLERANCE:
        raise ValueError("the camera would look at where it is; give another point")
    # From x right, y down and z forward of a level camera: first about the vertical, then up or down.
    heading = math.atan2(along[1], along[0])
    pitch = math.asin(along[2] / length)
    yaw, tilt = 0.5 * (heading - math.pi / 2.0), 0.5 * (pitch - math.pi / 2.0)
    # Rz(heading - 90 deg) turns x right, y forward, z up; Rx(pitch - 90 deg) makes z forward of it.
    return (
        math.cos(yaw) * math.sin(tilt),
        math.sin(yaw) * math.sin(tilt),
        math.sin(yaw) * math.cos(tilt),
        math.cos(yaw) * math.cos(tilt),
    )
