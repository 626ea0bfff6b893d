"""What the servo asks the planner for, where it is stuck."""

from __future__ import annotations

import numpy as np
import pytest

from zarm_contract.errors import PlanningFailed
from zarm_contract.messages import Plan, PlanRequest
from zarm_servo.tracking.global_plan import find_global_plan
from zarm_servo.tracking.targets import JointTarget

MARGIN = 0.03


def test_a_plan_is_requested_with_room_first_and_then_without() -> None:
    asked: list[PlanRequest] = []

    def ask(request: PlanRequest, _timeout: float) -> Plan:
        asked.append(request)
        raise PlanningFailed("there is a wall", code="no_path")

    with pytest.raises(PlanningFailed):
        find_global_plan(ask, ("a", "b"), MARGIN, JointTarget(np.ones(2)), np.zeros(2), 1.0, 0.5)
    kept = [(request.margin, request.self_margin) for request in asked]
    assert len(kept) == 2
    assert min(kept[0]) > MARGIN  # type: ignore[type-var]
    assert kept[1] == (MARGIN, MARGIN)
