"""The planners to choose from on the page."""

from __future__ import annotations

from zarm_planner.planners.registry import AUTO
from zarm_planner.planners.registry import PLANNERS as REGISTERED
from zarm_viewer.plan_options import PLANNERS


def test_the_page_offers_each_planner_that_exists_and_no_other() -> None:
    assert set(PLANNERS) == {AUTO, *(name for planner in REGISTERED for name in planner.names.values())}
