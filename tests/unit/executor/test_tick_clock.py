"""What the control loop knows of time: how long since the last tick, or since a motion has begun."""

from __future__ import annotations

import pytest

from zarm_executor.tick_clock import EARLIEST, TickClock


@pytest.fixture
def clock() -> TickClock:
    """At its second tick, 100.01 s."""
    made = TickClock(0.01)
    made.advance(100.0)
    assert made.advance(100.01) == pytest.approx(0.01)
    return made


def test_a_motion_begun_between_ticks_has_moved_since(clock: TickClock) -> None:
    clock.begin(100.017)
    assert clock.advance(100.02) == pytest.approx(0.003)
    assert clock.advance(100.03) == pytest.approx(0.01)


def test_an_early_beginning_is_caught_up_without_a_missed_tick(
    clock: TickClock,
) -> None:
    clock.begin(99.97)
    assert clock.advance(100.02) == pytest.approx(0.05)
    assert clock.missed == 0


def test_a_motion_never_goes_back_in_time(clock: TickClock) -> None:
    clock.begin(100.0201)
    assert clock.advance(100.02) == 0.0


def test_a_time_that_is_far_off_does_not_count(clock: TickClock) -> None:
    clock.begin(100.01 - EARLIEST - 0.02)
    assert clock.advance(100.02) == pytest.approx(0.01)
