"""A depth camera, made by where it is and what it looks at."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from zarm.values import Checked, numbers
from zarm_contract import messages
from zarm_contract.errors import InvalidRequest

if TYPE_CHECKING:
    from zarm.values import Numbers

_SAME = 1e-9


class Camera(Checked, messages.Camera):
    """A depth camera at `position` (m) in the frame of `link`, by default the base, that looks at the point `look_at` of that frame, upright. `orientation` may be
    given instead: of its optical frame, z forward, x right, y down.

    The other arguments are the fields of the [message](messages.md#camera), with the intrinsics in pixels.
    """

    def __init__(
        self,
        name: str,
        *,
        position: Numbers,
        look_at: Numbers | None = None,
        orientation: Numbers | None = None,
        **others: Any,
    ) -> None:
        place = numbers(position, "position")
        if (look_at is None) == (orientation is None):
            raise InvalidRequest("give either look_at or orientation", field="look_at")
        turn = numbers(orientation, "orientation") if orientation is not None else ()
        if look_at is not None:
            turn = _looking([at - eye for at, eye in zip(numbers(look_at, "look_at"), place, strict=True)])
        super().__init__(name=name, position=place, orientation=turn, **others)


def _looking(along: list[float]) -> tuple[float, float, float, float]:
    """The quaternion (x, y, z, w) of an optical frame that looks along a vector, its y as far down as possible."""
    length = math.hypot(*along)
    if length < _SAME:
        raise InvalidRequest("the camera would look at where it is; give another point", field="look_at")
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
