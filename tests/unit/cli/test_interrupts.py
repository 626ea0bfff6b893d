"""Ctrl-C comes up where a command waits, whatever it is doing when it comes."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator

import pytest

from zarm_cli import interrupts
from zarm_cli.interrupts import Inbox
from zarm_runtime import signals

BOTH = (signal.SIGINT, signal.SIGTERM)


@pytest.fixture(autouse=True)
def expected(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Signals are expected, as in a command that has just begun."""
    before = {number: signal.getsignal(number) for number in BOTH}
    monkeypatch.setattr(interrupts, "_state", type(interrupts._state)())
    before_fd = signal.set_wakeup_fd(-1)
    signals.received.clear()
    signals.expect()
    yield
    signals.received.clear()
    signal.set_wakeup_fd(before_fd)
    for number, handler in before.items():
        signal.signal(number, handler)


def from_elsewhere(number: int) -> None:
    """The signal comes while the main thread waits."""
    signal.pthread_kill(threading.main_thread().ident or 0, number)


class Door:
    """What must not be interrupted."""

    closed = False

    def __enter__(self) -> None: ...

    def __exit__(self, *_: object) -> None:
        signal.raise_signal(signal.SIGINT)
        self.closed = True


@pytest.mark.parametrize("number", BOTH)
def test_a_signal_between_waits_is_raised_at_the_next_wait(number: signal.Signals) -> None:
    signal.raise_signal(number)
    assert interrupts.pending()
    with pytest.raises(KeyboardInterrupt):
        interrupts.pause()
    assert not interrupts.pending()


def test_what_is_being_left_in_order_is_left_in_order() -> None:
    door = Door()
    with door:
        pass
    assert door.closed
    assert interrupts.pending()


@pytest.mark.parametrize("number", BOTH)
def test_a_signal_ends_a_wait_that_has_no_end(number: signal.Signals) -> None:
    threading.Timer(0.05, from_elsewhere, (number,)).start()
    with pytest.raises(KeyboardInterrupt):
        interrupts.pause()


def test_only_the_first_signal_counts() -> None:
    signal.raise_signal(signal.SIGINT)
    with pytest.raises(KeyboardInterrupt):
        interrupts.check()
    for number in BOTH:
        signal.raise_signal(number)
    interrupts.check()
    assert interrupts.wait_for(Inbox[int](), 0.0) is None


def test_work_that_goes_on_is_left_to_itself() -> None:
    begun, may_end, ended = (threading.Event() for _ in range(3))

    def work() -> None:
        begun.set()
        may_end.wait()
        ended.set()

    def interrupt() -> None:
        begun.wait()
        from_elsewhere(signal.SIGINT)

    threading.Thread(target=interrupt).start()
    with pytest.raises(KeyboardInterrupt):
        interrupts.run_interruptibly(work)
    may_end.set()
    assert ended.wait(10)


def test_work_is_told_of_as_it_ends() -> None:
    assert interrupts.run_interruptibly(lambda: 7) == 7
    with pytest.raises(ZeroDivisionError):
        interrupts.run_interruptibly(lambda: 1 // 0)
    assert interrupts.run_interruptibly(lambda: None) is None


def test_what_has_come_before_the_signal_is_not_lost() -> None:
    reported: Inbox[int] = Inbox()
    reported.put(1)
    assert interrupts.wait_for(reported) == 1
    threading.Timer(0.05, from_elsewhere, (signal.SIGINT,)).start()
    with pytest.raises(KeyboardInterrupt):
        interrupts.wait_for(reported)
    reported.put(2)
    assert interrupts.wait_for(reported) == 2


class Told:
    """Counts how often it is said what is waited for."""

    times = 0

    def __call__(self) -> None:
        self.times += 1


@pytest.fixture
def at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """A third signal counts from the beginning."""
    monkeypatch.setattr(interrupts, "_INSISTS", 0.0)


def test_of_three_signals_the_second_warns_and_the_third_leaves(at_once: None) -> None:
    reported = Told()
    with interrupts.insist(reported):
        for times in (0, 1):
            signal.raise_signal(signal.SIGINT)
            for _ in range(2):
                interrupts.check()
            assert reported.times == times
        signal.raise_signal(signal.SIGINT)
        with pytest.raises(KeyboardInterrupt):
            interrupts.wait_for(Inbox[int]())
    assert reported.times == 1


def test_what_was_ignored_while_insisting_comes_up_afterwards(at_once: None) -> None:
    with interrupts.insist(Told()):
        signal.raise_signal(signal.SIGINT)
        interrupts.check()
    with pytest.raises(KeyboardInterrupt):
        interrupts.check()


@pytest.mark.lengthy
def test_a_third_signal_counts_after_a_minimum_time() -> None:
    for _ in range(3):
        signal.raise_signal(signal.SIGINT)
    with interrupts.insist(Told()):
        assert interrupts.run_interruptibly(lambda: 7) == 7
        with pytest.raises(KeyboardInterrupt):
            interrupts.pause()
