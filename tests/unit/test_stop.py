"""A deadline that others bring forward, and those that end sooner with it."""

from __future__ import annotations

import pytest

from zarm_contract.errors import Cancelled, DeadlineExceeded
from zarm_planner.stop import Stop


def test_a_sooner_deadline_ends_no_later_and_with_a_cancel() -> None:
    stop = Stop(60.0)
    sooner, later = stop.sooner(1.0), stop.sooner(600.0)
    assert sooner.deadline[0] < stop.deadline[0]
    assert later.deadline[0] == pytest.approx(stop.deadline[0])
    stop.cancel()
    for one in (stop, sooner, later, stop.sooner(1.0)):
        with pytest.raises(Cancelled):
            one.check()


def test_a_sooner_deadline_that_passes_or_is_cancelled_leaves_the_other_alone() -> None:
    stop = Stop(60.0)
    passed, cancelled = stop.sooner(-1.0), stop.sooner(1.0)
    cancelled.cancel()
    with pytest.raises(DeadlineExceeded):
        passed.check()
    stop.check()
