"""The clock of a process: that of the machine, or one that is faster by the same factor in every process."""

from __future__ import annotations

import time
from collections.abc import Iterator

import pytest

from zarm_contract.errors import InvalidRequest
from zarm_runtime import clock

AWAY = 0.01


@pytest.fixture
def at_speed(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """`ZARM_SIM_SPEED` is 4, and not afterwards."""
    monkeypatch.setenv("ZARM_SIM_SPEED", "4")
    clock.read_speed()
    yield
    monkeypatch.delenv("ZARM_SIM_SPEED")
    clock.read_speed()


def test_preemption_between_clock_readings_moves_no_time(monkeypatch: pytest.MonkeyPatch) -> None:
    read, undisturbed = time.time, clock.unix_time_of(0.0)
    interruptions = [AWAY, AWAY]

    def interrupted() -> float:
        day = read()
        if interruptions:
            time.sleep(interruptions.pop())
        return day

    monkeypatch.setattr(time, "time", interrupted)
    assert clock.unix_time_of(0.0) == pytest.approx(undisturbed, abs=AWAY / 10)


def test_without_a_speed_the_time_is_that_of_the_machine() -> None:
    before, moment, after = time.time(), clock.unix_time(), time.time()
    assert before <= moment <= after
    assert time.monotonic() <= clock.monotonic() <= time.monotonic()
    assert clock.real_seconds(2.0) == 2.0


@pytest.mark.usefixtures("at_speed")
def test_everything_that_tells_the_time_is_as_fast() -> None:
    real, monotonic, day = time.monotonic(), clock.monotonic(), clock.unix_time()
    clock.sleep(0.4)
    passed = time.monotonic() - real
    assert clock.monotonic() - monotonic == pytest.approx(4.0 * passed, abs=AWAY)
    assert clock.unix_time() - day == pytest.approx(4.0 * passed, abs=AWAY)
    assert clock.unix_time_of(clock.monotonic()) == pytest.approx(clock.unix_time(), abs=AWAY)
    assert clock.real_seconds(4.0) == 1.0


@pytest.mark.parametrize("speed", ["0.5", "21", "fast", "nan"])
def test_a_speed_that_cannot_be_is_refused(speed: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ZARM_SIM_SPEED", speed)
    with pytest.raises(InvalidRequest, match=f"{speed} is no speed of a simulation") as refused:
        clock.read_speed()
    assert refused.value.problem.field == "ZARM_SIM_SPEED"
    assert clock.speed == 1.0
