"""The plans of an agent: each can be executed once, for a while."""

from __future__ import annotations

import threading
import time
from collections import OrderedDict

from zarm_contract.errors import ExecutionRefused, InvalidRequest
from zarm_contract.messages import Plan

LASTS = 120.0
"""A plan counts for this long (s)."""
_KEPT = 50


class PlanStore:
    """Plans by id; thread-safe."""

    def __init__(self) -> None:
        self._plans: OrderedDict[str, tuple[Plan, float]] = OrderedDict()
        self._lock = threading.Lock()

    def put(self, plan: Plan) -> None:
        """Remember a plan."""
        with self._lock:
            self._plans[plan.plan_id] = plan, time.monotonic()
            if len(self._plans) > _KEPT:
                self._plans.popitem(last=False)

    def see(self, plan_id: str) -> Plan:
        """A plan that has not been executed. Raises InvalidRequest for an unknown one, and ExecutionRefused for one that is too old."""
        with self._lock:
            return self._found(plan_id)

    def take(self, plan_id: str) -> Plan:
        """The same, for the only time."""
        with self._lock:
            plan = self._found(plan_id)
            del self._plans[plan_id]
            return plan

    def _found(self, plan_id: str) -> Plan:
        found = self._plans.get(plan_id)
        if found is None:
            raise InvalidRequest(
                f"there is no plan {plan_id[:64]}, or it was executed already; plan again", field="plan_id"
            )
        if time.monotonic() - found[1] > LASTS:
            raise ExecutionRefused(f"the plan is older than {LASTS:g} s; plan again", code="stale_plan")
        return found[0]
