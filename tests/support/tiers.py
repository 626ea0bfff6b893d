"""Which tests `make test` runs, and which repetitions CI."""

from __future__ import annotations

from typing import Any

import pytest

ESSENTIAL = (
    "access/test_table.py",
    "process/cli/test_demo.py",
    "process/client/test_robot.py",
    "process/executor/test_plans.py",
    "process/executor/test_preemption.py",
    "process/executor/test_stop.py",
    "process/guard/test_guard.py",
    "process/planner/test_life.py",
    "process/planner/test_plans.py",
    "process/test_scene_and_motion.py",
    "process/viewer/test_watching.py",
    "ros/one_stack",
    "unit/servo/test_adversary.py",
)
"""Modules and packages that `make test` runs besides the fast tests: each service once, as a process."""


def sampled(first: Any, *others: Any) -> list[Any]:
    """For `parametrize`: the first value as it is, the others marked as slow; a tuple is one value for each argument."""
    rows = (other if isinstance(other, tuple) else (other,) for other in others)
    return [first, *(pytest.param(*row, marks=pytest.mark.slow) for row in rows)]
