"""A button counts as held while requests come as a browser sends them, and by none that was held up on its way."""

from __future__ import annotations

from itertools import accumulate

from hypothesis import given
from hypothesis import strategies as st

from zarm_viewer.jog_panel import RATE
from zarm_viewer.jogger import HOLD, LATEST, SOONEST, Held

BUTTON = 1 / RATE
HELD_UP = st.floats(0.0, 0.9 * SOONEST)
"""s between two requests that waited together."""


def counted(gaps: list[float]) -> list[bool]:
    """Whether each request counts, by how long (s) after the one before it comes."""
    held = Held()
    return [held.asked(1, at) for at in accumulate(gaps, initial=10.0)][1:]


def test_a_held_button_counts_from_its_second_request() -> None:
    assert all(counted([BUTTON] * 10))
    assert HOLD > 2 * BUTTON


@given(silence=st.floats(1.1 * LATEST, 60.0), burst=st.lists(HELD_UP, max_size=50))
def test_what_was_held_up_moves_nothing_when_it_comes(silence: float, burst: list[float]) -> None:
    assert not any(counted([BUTTON, silence, *burst])[1:])


def test_requests_of_another_page_do_not_make_one_held() -> None:
    held = Held()
    assert not held.asked(1, 10.0)
    assert not held.asked(2, 10.05)
    assert held.asked(2, 10.1)
