"""Colours of objects."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from curobo_msgs.srv import AddObject

Colour = tuple[float, float, float, float]
"""Red, green, blue, alpha, 0..1."""


def colour_of(request: AddObject.Request) -> Colour | None:
    """The colour that a client gave; None if all four are 0, or one is outside 0..1."""
    c = request.color
    colour = (c.r, c.g, c.b, c.a)
    return colour if any(colour) and all(0.0 <= part <= 1.0 for part in colour) else None
