"""The executor with a preview that fails on the plan `plan-bad`: `python failing_preview.py ...` and its own options."""

from __future__ import annotations

import sys

import zarm_executor.ghost
import zarm_executor.service
from zarm_contract.messages import Plan

Ghost = zarm_executor.ghost.Ghost


class FailingGhost(Ghost):
    """Fails as with an internal fault."""

    def _begin(self, plan: Plan, now: float) -> None:
        super()._begin(plan, now)
        if plan.plan_id == "plan-bad":
            raise ZeroDivisionError("a fault of the preview")


if __name__ == "__main__":
    zarm_executor.service.Ghost = FailingGhost
    sys.exit(zarm_executor.service.main())
