"""A worker works when it is woken, from time to time, and whatever goes wrong."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable

import pytest

from zarm_runtime.worker import Worker

SOON = 10.0


class Calls:
    """Work that is counted, and does what `then` says."""

    def __init__(self, then: Callable[[int], float | None] = lambda _: None) -> None:
        self._then, self._count = then, 0
        self.made: queue.SimpleQueue[int] = queue.SimpleQueue()

    def __call__(self) -> float | None:
        self._count += 1
        self.made.put(self._count)
        return self._then(self._count)


def test_it_works_when_it_is_woken_and_not_before() -> None:
    calls = Calls()
    with Worker("worker", calls) as worker:
        with pytest.raises(queue.Empty):
            calls.made.get(timeout=0.1)
        for count in (1, 2):
            worker.wake()
            assert calls.made.get(timeout=SOON) == count


def test_a_wake_before_the_start_counts() -> None:
    calls = Calls()
    worker = Worker("worker", calls)
    worker.wake()
    with worker:
        assert calls.made.get(timeout=SOON) == 1


def test_it_works_every_period_or_after_the_time_it_returns() -> None:
    calls = Calls(lambda count: None if count < 3 else 1000.0)
    with Worker("worker", calls, 0.01):
        assert [calls.made.get(timeout=SOON) for _ in range(3)] == [1, 2, 3]
        with pytest.raises(queue.Empty):
            calls.made.get(timeout=0.1)


def test_wakes_during_a_call_lead_to_one_more() -> None:
    begun, go_on = threading.Event(), threading.Event()

    def held(count: int) -> None:
        if count == 1:
            begun.set()
            go_on.wait(SOON)

    calls = Calls(held)
    with Worker("worker", calls) as worker:
        worker.wake()
        assert begun.wait(SOON)
        worker.wake()
        worker.wake()
        go_on.set()
        assert [calls.made.get(timeout=SOON) for _ in range(2)] == [1, 2]
        with pytest.raises(queue.Empty):
            calls.made.get(timeout=0.1)


def test_after_an_exception_it_goes_on(caplog: pytest.LogCaptureFixture) -> None:
    def fails(count: int) -> None:
        if count == 1:
            raise ValueError("of the first call")

    calls = Calls(fails)
    with Worker("worker", calls, 0.01):
        assert [calls.made.get(timeout=SOON) for _ in range(2)] == [1, 2]
    assert "of the first call" in caplog.text


def test_nothing_is_called_after_it_has_stopped() -> None:
    calls = Calls()
    with Worker("worker", calls) as worker:
        pass
    worker.wake()
    with pytest.raises(queue.Empty):
        calls.made.get(timeout=0.1)


def test_one_that_never_began_can_be_stopped() -> None:
    Worker("worker", Calls()).stop()
