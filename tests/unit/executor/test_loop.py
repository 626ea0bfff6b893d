from __future__ import annotations

import itertools
import subprocess
import sys
import threading
import time

import pytest

from support.harness import PATIENCE, eventually
from zarm_executor.loop import Loop

PERIOD = 0.005
PERIODS = pytest.mark.parametrize("period", [0.01, 0.004, 0.002])


@pytest.mark.lengthy
@PERIODS
def test_calls_come_on_a_grid_of_the_clock_and_none_twice(period: float) -> None:
    calls: list[float] = []
    with Loop("test", period, calls.append):
        eventually(lambda: len(calls) >= 50, "there were 50 calls")
    periods = [(call - calls[0]) / period for call in calls]
    assert [round(period) for period in periods] == pytest.approx(periods, abs=1e-6)
    assert all(later > earlier for earlier, later in itertools.pairwise(periods))


@pytest.mark.lengthy
def test_no_call_comes_before_its_time() -> None:
    late: list[float] = []
    with Loop("test", PERIOD, lambda now: late.append(time.monotonic() - now)):
        eventually(lambda: len(late) >= 50, "there were 50 calls")
    assert min(late) > -1e-6


@PERIODS
def test_deadlines_that_pass_while_a_call_lasts_are_left_out(period: float) -> None:
    calls: list[float] = []

    def work(now: float) -> None:
        calls.append(now)
        if len(calls) == 3:
            eventually(lambda: time.monotonic() > now + 10.5 * period, "ten deadlines have passed")

    with Loop("test", period, work):
        eventually(lambda: len(calls) >= 5, "there were calls after the long one")
    assert calls[3] - calls[2] > 9.5 * period


def test_a_loop_ends_with_its_block() -> None:
    calls: list[float] = []
    with Loop("test", PERIOD, calls.append):
        eventually(lambda: calls, "there was a call")
    assert not any(thread.name == "test" for thread in threading.enumerate())


def test_a_loop_may_be_started_again() -> None:
    calls: list[float] = []
    loop = Loop("test", PERIOD, calls.append)
    for _ in range(2):
        calls.clear()
        loop.start()
        eventually(lambda: calls, "there was a call")
        loop.stop()


def test_an_exception_in_a_loop_ends_the_process_with_a_trace() -> None:
    program = (
        "import threading\n"
        "from zarm_executor.loop import Loop\n"
        "with Loop('control', 0.01, lambda now: 1 / 0):\n"
        "    threading.Event().wait()\n"
    )
    ended = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, timeout=PATIENCE, check=False
    )
    assert ended.returncode == 1
    assert "the loop control failed" in ended.stderr
    assert "ZeroDivisionError" in ended.stderr
