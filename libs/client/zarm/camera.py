"""A depth camera, made by where it is and what it looks at."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from zarm.values import Checked, numbers
from zarm_contract import messages
from zarm_contract.errors import InvalidRequest
from zarm_contract.looking import looking

if TYPE_CHECKING:
    from zarm.values import Numbers


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
            try:
                turn = looking(place, numbers(look_at, "look_at"))
            except ValueError as error:
                raise InvalidRequest(str(error), field="look_at") from error
        super().__init__(name=name, position=place, orientation=turn, **others)
