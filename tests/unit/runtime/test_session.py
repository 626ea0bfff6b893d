"""A session opens with a clear word, outlives its router, and closes without leaving anything behind."""

from __future__ import annotations

import queue
import threading

import pytest

from support.declared import declared
from support.harness import PATIENCE, eventually, free_endpoint
from zarm_contract import messages as m
from zarm_contract.errors import InvalidRequest, Unavailable
from zarm_contract.keys import Keys
from zarm_runtime.bus import Bus
from zarm_runtime.session import open_router

KEYS = Keys("arm")
IDLE = m.ExecutorState(mode="idle", strategy="emulator", speed_scale=1.0, missed_ticks=0)


def ask(bus: Bus) -> bool:
    """Whether a call is answered."""
    try:
        return bus.call(KEYS.stop, m.Nothing(), timeout=PATIENCE) == IDLE
    except Unavailable:
        return False


# -- opening --


def test_without_a_router_opening_fails_with_the_remedy() -> None:
    endpoint = free_endpoint()
    with pytest.raises(Unavailable, match=f"no Zenoh router answers at {endpoint}; start one with `zarm up`"):
        Bus(endpoint, timeout=0.1)


def test_a_taken_port_is_said(endpoint: str) -> None:
    with pytest.raises(Unavailable, match=f"cannot listen at {endpoint}"):
        open_router(endpoint)


@pytest.mark.parametrize(
    "endpoint",
    ["", "localhost", "127.0.0.1:7447", "tcp/", "tcp/127.0.0.1", "http/127.0.0.1:7447", "tcp/127.0.0.1:7447 "],
)
def test_what_is_no_endpoint_is_refused(endpoint: str) -> None:
    with pytest.raises(InvalidRequest, match=r"write it like tcp/127\.0\.0\.1:7447"):
        Bus(endpoint)


# -- closing --


def test_closing_leaves_no_thread_and_twice_is_harmless(endpoint: str) -> None:
    before = set(threading.enumerate())
    bus = Bus(endpoint)
    bus.serve(KEYS.stop, lambda _: IDLE)
    bus.latched(KEYS.executor_state).set(IDLE)
    bus.publisher(KEYS.joint_states)
    bus.latest(KEYS.joint_states)
    bus.watch(KEYS.executor_state, lambda *_: None)
    bus.declare_alive(KEYS.alive("executor", "a"))
    assert ask(bus)
    assert set(threading.enumerate()) > before
    bus.close()
    eventually(lambda: set(threading.enumerate()) == before, "its threads have ended")
    bus.close()


def test_a_session_that_is_closed_answers_unavailable(endpoint: str) -> None:
    with Bus(endpoint) as bus:
        pass
    with pytest.raises(Unavailable):
        bus.call(KEYS.stop, m.Nothing(), timeout=PATIENCE)


def test_closing_finishes_the_present_request_and_refuses_others(endpoint: str, other: Bus) -> None:
    entered, release = threading.Event(), threading.Event()

    def handler(_: m.Nothing) -> m.ExecutorState:
        entered.set()
        release.wait(PATIENCE)
        return IDLE

    bus = Bus(endpoint)
    bus.serve(KEYS.stop, handler, workers=1)
    declared(bus)
    answers: queue.SimpleQueue[bool] = queue.SimpleQueue()
    in_hand = threading.Thread(target=lambda: answers.put(ask(other)))
    in_hand.start()
    assert entered.wait(PATIENCE)
    closing = threading.Thread(target=bus.close)
    closing.start()
    eventually(lambda: not ask(other), "new requests are refused")
    assert closing.is_alive()
    release.set()
    for thread in (closing, in_hand):
        thread.join(PATIENCE)
        assert not thread.is_alive()
    assert answers.get_nowait() is True


# -- a router that goes away --


def test_when_the_router_is_gone_and_back_everything_works_again() -> None:
    endpoint = free_endpoint()
    router = open_router(endpoint)
    with Bus(endpoint) as service, Bus(endpoint) as client:
        service.serve(KEYS.stop, lambda _: IDLE)
        state = service.latched(KEYS.executor_state)
        service.declare_alive(KEYS.alive("executor", "a"))
        inbox: queue.SimpleQueue[m.ExecutorState] = queue.SimpleQueue()
        client.subscribe(KEYS.executor_state, lambda _, message: inbox.put(message))
        declared(service)
        assert ask(client)

        router.close()
        eventually(lambda: not ask(client), "calls say that nobody answers")

        router = open_router(endpoint)
        eventually(lambda: ask(client), "calls are answered again")
        eventually(lambda: client.alive(KEYS.alive("*", "*")), "the service is seen again")
        eventually(lambda: state.set(IDLE) and not inbox.empty(), "publications arrive again")
        assert inbox.get_nowait() == IDLE
    router.close()
