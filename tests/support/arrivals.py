"""Arrival numbers in the order of a test's requests, as the bus gives them to commands."""

from __future__ import annotations

import itertools

_numbers = itertools.count(1)


def arrival() -> int:
    """The next number."""
    return next(_numbers)
