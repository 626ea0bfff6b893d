"""How far ahead a new trajectory takes over."""

from __future__ import annotations

from itertools import pairwise

from zarm_servo.guarding.lead import LONGEST, SHORTEST, Lead


def lead_after(*took: float) -> Lead:
    lead = Lead()
    for seconds in took:
        lead.in_time(seconds)
    return lead


def test_one_slow_plan_does_not_delay_the_next_takeovers() -> None:
    assert lead_after(0.01, 0.02, 0.3, 0.02).seconds == SHORTEST


def test_where_plans_are_slow_the_lead_is_longer_than_they_take() -> None:
    assert 0.1 < lead_after(0.1, 0.1, 0.1, 0.1).seconds < 0.2


def test_late_trajectories_lengthen_the_lead_until_in_time() -> None:
    lead = Lead()
    given = [lead.seconds]
    for _ in range(3):
        lead.too_late()
        given.append(lead.seconds)
    assert given[0] == SHORTEST
    assert all(later > 1.4 * earlier for earlier, later in pairwise(given))
    lead.in_time(0.02)
    assert lead.seconds == SHORTEST


def test_the_lead_is_bounded() -> None:
    assert lead_after(1.0, 1.0).seconds == LONGEST
    lead = Lead()
    for _ in range(2000):
        lead.too_late()
    assert lead.seconds == LONGEST
