"""Rounded numbers as JSON text, without the GIL: a general writer first has to find out how many digits a number needs."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from zarm_geometry.kernels.compiled import inlined, kernel
from zarm_planner.kernels.ramps import Array
from zarm_planner.kernels.rounding import MOST

Text = NDArray[np.uint8]

_COMMA, _MINUS, _POINT, _ZERO, _OPEN, _CLOSE = b",-.0[]"
_PAIRS = np.frombuffer("".join(f"{number:02d}" for number in range(100)).encode(), np.uint8)
_LARGEST = 1e14
"""Numbers of more decimal units are left to others: beyond 2^53 of them a float does not hold each."""
_WIDEST = 3 * MOST
"""Characters per number, at most: sign, 15 digits and as many decimals, point and comma."""


@inlined
def _digits(out: Text, end: int, number: np.uint64, count: int) -> None:
    """Write the last `count` digits of a number, up to `end`, two at a time."""
    hundred = np.uint64(100)
    while count >= 2:
        rest = number // hundred
        pair = 2 * (number - rest * hundred)
        out[end - 2], out[end - 1] = _PAIRS[pair], _PAIRS[pair + 1]
        number, end, count = rest, end - 2, count - 2
    if count == 1:
        out[end - 1] = _ZERO + number % np.uint64(10)


@inlined
def _number(out: Text, n: int, value: float, least: int) -> int:
    """Write a number at `n`, and return where it ends; -1 if it is not a decimal number of up to MOST decimals.

    The decimals to try first are `least`, at least one. A reader gets the same number again: both the division here and reading a
    decimal number round the exact quotient to the nearest float.
    """
    if value < 0.0:
        out[n] = _MINUS
        n, value = n + 1, -value
    decimals, scale = least, 10.0**least
    units = np.rint(value * scale)
    while units / scale != value:
        if decimals == MOST or not units < _LARGEST:
            return -1
        decimals, scale = decimals + 1, scale * 10.0
        units = np.rint(value * scale)
    if not units < 10.0 * _LARGEST:
        return -1
    whole = np.uint64(value)  # no rounding of the quotient can reach the next whole number: it has 15 digits at most
    part = np.uint64(units) - whole * np.uint64(scale)
    count, left = 1, whole // np.uint64(10)
    while left > np.uint64(0):
        count, left = count + 1, left // np.uint64(10)
    n += count
    _digits(out, n, whole, count)
    out[n] = _POINT
    n += 1 + decimals
    _digits(out, n, part, decimals)
    while out[n - 1] == _ZERO and out[n - 2] != _POINT:
        n -= 1
    return n


@inlined
def _rows(values: Array, least: int) -> Text:
    """All rows of `values` (n, dof) but the first and the last, each followed by a comma; empty if there is a number
    that `_number` does not write.
    """
    rows, dof = values.shape
    out = np.empty(rows * (dof * _WIDEST + 3), np.uint8)
    n = 0
    for i in range(1, rows - 1):
        out[n] = _OPEN
        n += 1
        for j in range(dof):
            n = _number(out, n, values[i, j], least)
            if n < 0:
                return out[:0]
            out[n] = _COMMA
            n += 1
        out[n - 1], out[n] = _CLOSE, _COMMA
        n += 1
    return out[:n]


@kernel
def write_inner_rows(
    position: Array, velocity: Array, acceleration: Array, least: tuple[int, int, int]
) -> tuple[Text, Text, Text]:
    """The JSON text of all rows of positions, velocities and accelerations (n, dof) but the first and the last, each
    row followed by a comma. Texts are empty if a number has more than MOST decimals.

    `least` are the decimals that most numbers of each have.
    """
    return _rows(position, least[0]), _rows(velocity, least[1]), _rows(acceleration, least[2])
