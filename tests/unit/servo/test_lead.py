"""How far ahead a replanned trajectory takes over: it is seldom too late for that, though how long planning takes varies."""

from __future__ import annotations

import pytest

from zarm_servo.lead import LONGEST, Lead

TICK = 0.012
"""What is known of where the robot is commanded may be so old (s)."""
QUIET = (19, 24, 26, 25, 22, 52, 16, 35, 19, 38, 14, 22, 17, 17, 39, 37, 40, 23, 20, 20, 23)
BUSY = (
    33,
    45,
    28,
    37,
    23,
    28,
    45,
    29,
    19,
    37,
    48,
    28,
    54,
    37,
    43,
    25,
    26,
    53,
    36,
    24,
    26,
    27,
    30,
    42,
    19,
    38,
    44,
    39,
    29,
    19,
    22,
)
"""How long (ms) it took to plan and hand over, one time after the other: on two cores, and beside as many busy processes."""


@pytest.mark.parametrize("took", [QUIET, BUSY], ids=["quiet", "busy"])
def test_of_the_times_as_they_were_measured_one_in_fifteen_is_too_late_at_most(took: tuple[int, ...]) -> None:
    lead, late = Lead(), 0
    for seconds in (each / 1000 for each in took):
        if seconds + TICK <= lead.seconds:
            lead.in_time(seconds)
        else:
            lead.too_late()
            late += 1
    assert late <= len(took) / 15


def test_what_comes_too_late_is_given_more_time_up_to_a_bound_until_something_is_in_time() -> None:
    lead = Lead()
    shortest = lead.seconds
    for _ in range(20):
        before = lead.seconds
        lead.too_late()
        assert before < lead.seconds or before == LONGEST
    lead.in_time(0.001)
    assert lead.seconds == shortest
