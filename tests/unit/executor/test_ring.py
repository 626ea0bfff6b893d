"""The ring holds the last of what passed, within its bounds."""

from __future__ import annotations

import threading
import tracemalloc
from collections.abc import Callable
from itertools import pairwise

import pytest

from support.tiers import sampled
from zarm_contract.keys import Keys
from zarm_contract.messages import JointState, Message, Plan
from zarm_executor import ring as module
from zarm_executor.ring import Ring

KEYS = Keys("arm")


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Callable[[float], None]:
    """Sets the ring's clock (s), which begins at 0."""
    now = [0.0]
    monkeypatch.setattr(module.time, "monotonic", lambda: now[0])

    def set_to(seconds: float) -> None:
        now[0] = seconds

    return set_to


def payloads(ring: Ring) -> list[bytes]:
    return [payload for _, _, payload in ring.contents()[1]]


def test_the_ring_keeps_its_length_of_time_in_order(clock) -> None:
    ring = Ring(KEYS, seconds=60)
    for tick in range(10_000):  # 100 s
        clock(tick / 100)
        ring.observe(KEYS.joint_states, b"%d" % tick)
    held = [int(payload) for payload in payloads(ring)]
    assert held == list(range(held[0], 10_000))
    assert 6000 <= len(held) <= 6300
    stamps = [stamp for stamp, _, _ in ring.contents()[1]]
    assert all(before <= after for before, after in pairwise(stamps))


def test_the_memory_of_the_ring_is_bounded_whatever_comes(clock) -> None:
    size = 1_000_000
    ring = Ring(KEYS, seconds=60, size=size)
    for tick in range(5_000):
        clock(tick / 1000)
        ring.observe(KEYS.driver_command, bytes(tick % 3000))
        assert sum(map(len, payloads(ring)[:1])) <= size
    assert size / 2 < sum(map(len, payloads(ring))) <= size
    assert payloads(ring)[-1] == bytes(4_999 % 3000)


@pytest.mark.parametrize(("key", "model"), [(KEYS.plans, Plan), (KEYS.driver_joint_states, JointState)])
def test_a_message_too_large_to_read_is_left_out(key: str, model: type[Message]) -> None:
    ring = Ring(KEYS)
    longest = bytes(model.max_bytes)
    ring.observe(key, longest)
    ring.observe(key, longest + b" ")
    assert payloads(ring) == [longest]


@pytest.mark.lengthy
@pytest.mark.parametrize("length", sampled(100, 10, 1000))
def test_the_size_of_the_ring_is_what_it_takes_of_memory(length: int) -> None:
    size = 4 * 2**20
    tracemalloc.start()
    try:
        ring = Ring(KEYS, size=size)
        for _ in range(2 * size // (length + 200)):
            ring.observe("".join(KEYS.driver_joint_states), bytes(length))
        taken, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert 0.75 * size < taken <= 1.02 * size


def test_the_preview_and_what_is_no_publication_are_left_out() -> None:
    ring = Ring(KEYS)
    for key in (KEYS.preview_joint_states, KEYS.preview_trajectory, KEYS.health("executor"), Keys("leg").joint_states):
        ring.observe(key, b"{}")
    assert payloads(ring) == []


def test_what_held_when_the_ring_begins_is_told_too(clock) -> None:
    ring = Ring(KEYS, seconds=60)
    ring.observe(KEYS.executor_state, b"running")
    ring.observe(KEYS.strategy, b"emulator")
    for second in range(1, 200):
        clock(float(second) * 1.5)
        ring.observe(KEYS.joint_states, b"%d" % second)
        if second == 190:
            ring.observe(KEYS.executor_state, b"idle")
    before, entries = ring.contents()
    assert {key: payload for _, key, payload in before} == {KEYS.executor_state: b"running", KEYS.strategy: b"emulator"}
    assert (KEYS.executor_state, b"idle") in {(key, payload) for _, key, payload in entries}
    assert all(stamp <= entries[0][0] for stamp, _, _ in before)


@pytest.mark.lengthy
def test_several_threads_may_append_while_another_reads() -> None:
    ring = Ring(KEYS)
    each = 20_000

    def append(name: int) -> None:
        for k in range(each):
            ring.observe(KEYS.goal(f"goal-{name}"), b"%d" % k)

    threads = [threading.Thread(target=append, args=(name,)) for name in range(4)]
    for thread in threads:
        thread.start()
    while any(thread.is_alive() for thread in threads):
        ring.contents()
    for thread in threads:
        thread.join()
    for name in range(4):
        own = [int(payload) for _, key, payload in ring.contents()[1] if key == KEYS.goal(f"goal-{name}")]
        assert own == list(range(each))
