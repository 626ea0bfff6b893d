"""A deadline that others bring forward, and those that end sooner with it."""

from __future__ import annotations

import pytest

from zarm_contract.errors import Cancelled, DeadlineExceeded
from zarm_planner.deadline import GUARANTEED, Deadline


def test_a_sooner_deadline_ends_no_later_and_with_a_cancel() -> None:
    stop = Deadline(60.0)
    sooner, later = stop.sooner(1.0), stop.sooner(600.0)
    assert sooner.at[0] < stop.at[0]
    assert later.at[0] == pytest.approx(stop.at[0])
    stop.cancel()
    for one in (stop, sooner, later, stop.sooner(1.0)):
        with pytest.raises(Cancelled):
            one.check()


def test_a_sooner_deadline_that_passes_or_is_cancelled_leaves_the_other_alone() -> None:
    stop = Deadline(60.0)
    passed, cancelled = stop.sooner(-1.0), stop.sooner(1.0)
    cancelled.cancel()
    with pytest.raises(DeadlineExceeded):
        passed.check()
    stop.check()


def test_what_gives_way_keeps_what_is_guaranteed_and_the_deadline_itself_stays() -> None:
    stop = Deadline(60.0)
    before = stop.at[0]
    long, short, cancelled = stop.sooner(30.0), stop.sooner(GUARANTEED / 2), stop.sooner(30.0)
    soon = short.at[0]
    cancelled.cancel()
    stop.give_way()
    assert long.at[0] == pytest.approx(before - 60.0 + GUARANTEED, abs=1e-3)
    assert (stop.at[0], short.at[0]) == (before, soon)
    assert cancelled.cancelled
