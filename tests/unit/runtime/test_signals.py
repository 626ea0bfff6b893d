"""No signal is lost, whenever it comes."""

from __future__ import annotations

import math
import os
import subprocess
import sys
import threading
from collections.abc import Iterator

import pytest

from support.paths import PROGRAMS
from zarm_runtime import signals

PROGRAM = PROGRAMS / "aimed_signals.py"
COUNT = os.environ.get("ZARM_TEST_SIGNALS", "3000")
"""100000 take a minute."""


@pytest.fixture(autouse=True)
def unwoken() -> Iterator[None]:
    """Nobody has called `wake` before, or has when the next test begins."""
    signals.wait(0.0)
    yield
    signals.wait(0.0)


@pytest.mark.lengthy
@pytest.mark.timeout(600)
def test_a_signal_ends_a_wait_at_any_moment() -> None:
    aimed = subprocess.run([sys.executable, PROGRAM, COUNT], capture_output=True, text=True)
    assert (aimed.returncode, aimed.stderr) == (0, "")


def test_whoever_wakes_before_the_wait_ends_it_too() -> None:
    signals.wake()
    signals.wait()


@pytest.mark.parametrize("seconds", [1e9, math.inf])
def test_another_thread_ends_a_wait_however_long(seconds: float) -> None:
    threading.Timer(0.05, signals.wake).start()
    signals.wait(seconds)


def test_waking_more_often_than_there_is_room_for_is_waking_once() -> None:
    for _ in range(100_000):
        signals.wake()
    signals.wait()
