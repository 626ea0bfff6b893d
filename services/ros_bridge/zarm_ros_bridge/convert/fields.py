"""Fields of requests: numbers that are not finite, and the field names that a ROS client knows."""

from __future__ import annotations

import math
from collections.abc import Mapping

from zarm_contract.errors import InvalidRequest, ZarmError, from_problem


def finite(value: float, field: str) -> float:
    """The number itself. Raises InvalidRequest if it is NaN or infinite."""
    if not math.isfinite(value):
        raise InvalidRequest(f"{value} is not a finite number; give one", field=field)
    return value


def in_terms_of(error: ZarmError, fields: Mapping[str, str]) -> ZarmError:
    """The same error with its field under the name of the ROS client; `fields` are bus names, or prefixes of them."""
    at = error.problem.field or ""
    for known, name in fields.items():
        if at == known or at.startswith(f"{known}."):
            return from_problem(error.problem.model_copy(update={"field": name + at.removeprefix(known)}))
    return error
