"""The stamp of a moment does not depend on what else had the processor while the clocks were read."""

from __future__ import annotations

import time

import pytest

from zarm_executor.clocks import time_of_day

AWAY = 0.01


def test_preemption_between_clock_readings_moves_no_time(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    read, undisturbed = time.time, time_of_day(0.0)
    interruptions = [AWAY, AWAY]

    def interrupted() -> float:
        day = read()
        if interruptions:
            time.sleep(interruptions.pop())
        return day

    monkeypatch.setattr(time, "time", interrupted)
    assert time_of_day(0.0) == pytest.approx(undisturbed, abs=AWAY / 10)
