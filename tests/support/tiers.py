"""Which repetitions `make test` runs."""

from __future__ import annotations

from typing import Any

import pytest


def sampled(first: Any, *others: Any) -> list[Any]:
    """For `parametrize`: the first value as it is, the others marked as slow; a tuple is one value for each argument."""
    rows = (other if isinstance(other, tuple) else (other,) for other in others)
    return [first, *(pytest.param(*row, marks=pytest.mark.slow) for row in rows)]
