"""ROS messages with faults, the same for the same seed."""

from __future__ import annotations

import copy
import random
from array import array
from typing import Any

NUMBERS = (float("nan"), float("inf"), -float("inf"), 1e308, -1e308, 5e-324, -0.0, 0.5, -1.0, 1e6)
WHOLE = (-(2**31), -1000, -2, -1, 0, 1, 2, 5, 100, 255, 2**31 - 1)
TEXTS = ("", " ", "joint_1", "../../etc/passwd", "\u202e\U0001f9be", "'; --", "{}", "%s %d", "a\nb", "x" * 10_000)
_RANGES = {
    f"{sign}int{bits}": (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1) if not sign else (0, 2**bits - 1)
    for sign in ("", "u")
    for bits in (8, 16, 32, 64)
}


def damaged(message: Any, chance: random.Random, share: float) -> Any:
    """A copy in which each value has been changed with this probability, to another one valid for its type; lists
    change their length.
    """
    changed = copy.deepcopy(message)
    for name, kind in message.get_fields_and_field_types().items():
        setattr(changed, name, _value(getattr(message, name), kind, chance, share))
    return changed


def _value(value: Any, kind: str, chance: random.Random, share: float) -> Any:
    if hasattr(value, "get_fields_and_field_types"):
        return damaged(value, chance, share)
    if isinstance(value, list | array):
        item = kind.removeprefix("sequence<").removesuffix(">")
        items = [_value(one, item, chance, share / 3) for one in value]
        if items and chance.random() < share:
            items = (items * 3)[: chance.choice((0, 1, len(items) - 1, len(items) + 1, 2 * len(items) + 1))]
        return array(value.typecode, items) if isinstance(value, array) else items
    if chance.random() > share:
        return value
    if isinstance(value, bool):
        return not value
    if isinstance(value, int):
        low, high = _RANGES[kind]
        return min(max(chance.choice(WHOLE), low), high)
    if isinstance(value, float):
        number = chance.choice(NUMBERS)
        return number if kind == "double" or abs(number) < 1e38 else 0.25
    return chance.choice(TEXTS)
