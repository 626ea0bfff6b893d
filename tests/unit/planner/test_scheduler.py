"""Whose turn is next, what gives way to whom, and how work is ended: threads that say what they do, and events."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager

import pytest

from support.harness import PATIENCE, eventually
from zarm_contract.errors import Cancelled, DeadlineExceeded
from zarm_contract.messages import Requester
from zarm_planner import scheduler
from zarm_planner.deadline import Deadline
from zarm_planner.scheduler import WITHDRAWN, Scheduler
from zarm_runtime.requester import ANYONE


def client(name: str, timeout: float = PATIENCE) -> Requester:
    return Requester(client=name, timeout=timeout)


class Bench:
    """Asks for work in threads; `begun` are the names of what has begun, in order, and each ends when it is told to."""

    def __init__(self, slots: int, pool: ThreadPoolExecutor) -> None:
        self.there: set[str] = set()
        self.running = Scheduler(slots, self.there.__contains__)
        self.begun: list[str] = []
        self._pool = pool
        self._ends: dict[str, threading.Event] = {}

    def ask(
        self, name: str, *, until: str = "told", requester: Requester | None = None, timeout: float = PATIENCE
    ) -> Future[str]:
        """Work of the client that the first letter of the name stands for: until it is told, or asked to give way."""
        ending = self._ends[name] = threading.Event()

        def work(stop: Deadline) -> str:
            self.begun.append(name)
            optimisation = stop.sooner(PATIENCE) if until == "asked" else None
            while not ending.wait(0.001):
                stop.check()
                if optimisation is not None and optimisation.passed:
                    return f"{name} gave way"
            return f"{name} was told"

        known = self.in_hand
        answer = self._pool.submit(self.running.run, work, requester or client(name[0]), timeout, name)
        eventually(lambda: self.in_hand > known or answer.done(), f"{name} is in hand")
        return answer

    def tell(self, name: str) -> None:
        """Have this work end."""
        self._ends[name].set()

    def has_begun(self, *names: str) -> None:
        """Wait until these have begun, in this order and nothing else."""
        eventually(lambda: len(self.begun) >= len(names), f"{names} have begun")
        assert self.begun == [*names]

    @property
    def in_hand(self) -> int:
        return len(self.running._jobs)


@contextmanager
def bench(slots: int) -> Iterator[Bench]:
    with ThreadPoolExecutor(32) as pool:
        one = Bench(slots, pool)
        try:
            yield one
        finally:
            one.running.close()


def test_idle_clients_go_first_and_then_all_take_turns(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scheduler, "LONG", PATIENCE)
    with bench(2) as one:
        for name in ("a1", "a2", "a3", "a4", "a5", "b1", "c1", "b2"):
            one.ask(name)
        one.has_begun("a1", "a2")
        for reported, next_one in (("a1", "b1"), ("a2", "a3"), ("b1", "c1"), ("a3", "b2"), ("c1", "a4"), ("b2", "a5")):
            known = [*one.begun]
            one.tell(reported)
            one.has_begun(*known, next_one)


def test_long_work_keeps_its_slot_from_its_own_client_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scheduler, "LONG", 0.0)
    with bench(1) as one:
        for name in ("a1", "a2", "b1", "b2"):
            one.ask(name)
        one.has_begun("a1", "b1")
        one.tell("a1")
        one.has_begun("a1", "b1", "a2")


def test_optimisation_gives_way_to_what_its_own_client_asks_for() -> None:
    with bench(1) as one:
        first = one.ask("a1", until="asked")
        one.ask("a2")
        assert first.result(PATIENCE) == "a1 gave way"
        one.has_begun("a1", "a2")


def test_a_turn_given_between_two_looks_makes_nobody_yield(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[Deadline] = []
    monkeypatch.setattr(Deadline, "give_way", asked.append)
    with bench(1) as one:
        only = one.ask("a1")
        one.has_begun("a1")
        (job,) = one.running._jobs
        one.running._press(job)
        assert not asked
        one.tell("a1")
        assert only.result(PATIENCE) == "a1 was told"


def test_optimisation_yields_to_clients_that_run_less(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(scheduler, "LONG", PATIENCE)
    with bench(2) as one:
        greedy, modest = one.ask("a1"), one.ask("b1", until="asked")
        waiting = one.ask("a2", timeout=0.2)
        with pytest.raises(DeadlineExceeded):
            waiting.result(PATIENCE)
        assert not modest.done()
        one.ask("c1")
        assert modest.result(PATIENCE) == "b1 gave way"
        one.has_begun("a1", "b1", "c1")
        one.tell("a1")
        assert greedy.result(PATIENCE) == "a1 was told"


def test_what_nobody_waits_for_any_longer_does_not_begin() -> None:
    with bench(1) as one:
        one.ask("a1")
        impatient = one.ask("a2", requester=client("a", timeout=0.1))
        with pytest.raises(DeadlineExceeded):
            impatient.result(PATIENCE)
        one.has_begun("a1")


def test_all_that_a_client_has_in_hand_ends_when_it_leaves(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scheduler, "LONG", PATIENCE)
    with bench(1) as one:
        left = [one.ask("a1"), one.ask("a2")]
        stays = one.ask("b1")
        one.running.leave("a")
        for answer in left:
            with pytest.raises(Cancelled):
                answer.result(PATIENCE)
        one.has_begun("a1", "b1")
        one.tell("b1")
        assert stays.result(PATIENCE) == "b1 was told"


def test_a_client_s_requests_end_when_it_leaves() -> None:
    with bench(1) as one:
        one.running.leave("a")
        with pytest.raises(Cancelled):
            one.ask("a1").result(PATIENCE)
        one.there.add("a")
        answer = one.ask("a2")
        one.tell("a2")
        assert answer.result(PATIENCE) == "a2 was told"


def test_a_cancel_ends_what_runs_and_what_waits_under_its_name() -> None:
    with bench(1) as one:
        for answer, name in [(one.ask("a1"), "a1"), (one.ask("a2"), "a2")]:
            assert one.running.cancel(name)
            with pytest.raises(Cancelled):
                answer.result(PATIENCE)


def test_a_cancel_that_overtakes_its_request_ends_only_it() -> None:
    with bench(1) as one:
        assert not one.running.cancel("a1")
        other = one.ask("a2")
        with pytest.raises(Cancelled):
            one.ask("a1").result(PATIENCE)
        one.tell("a2")
        assert other.result(PATIENCE) == "a2 was told"
        one.has_begun("a2")


def test_a_cancel_ends_one_request_and_expires(monkeypatch: pytest.MonkeyPatch) -> None:
    work = Scheduler(1, lambda _: False)
    work.cancel("again")
    with pytest.raises(Cancelled):
        work.run(lambda _: "done", ANYONE, PATIENCE, "again")
    assert work.run(lambda _: "done", ANYONE, PATIENCE, "again") == "done"
    work.cancel("late")
    monkeypatch.setattr(scheduler, "WITHDRAWN_S", 0.0)
    assert work.run(lambda _: "done", ANYONE, PATIENCE, "late") == "done"


def test_so_many_cancels_are_remembered_and_no_more() -> None:
    work = Scheduler(1, lambda _: False)
    for number in range(WITHDRAWN + 1):
        work.cancel(f"r{number}")
    assert work.run(lambda _: "done", ANYONE, PATIENCE, "r0") == "done"
    with pytest.raises(Cancelled):
        work.run(lambda _: "done", ANYONE, PATIENCE, "r1")
