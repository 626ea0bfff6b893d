"""A payload of the greatest length passes the router, a longer one does not, with certificates and without."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
import zenoh

from support.harness import eventually, router
from support.tiers import sampled
from zarm_contract.codec import MAX_BYTES
from zarm_contract.errors import InvalidRequest
from zarm_contract.keys import Keys
from zarm_contract.messages import ExecuteRequest
from zarm_runtime.bus import Bus
from zarm_runtime.session import ROUTER_MAX_BYTES, open_client

KEYS = Keys("some_robot")
LONGER = (ROUTER_MAX_BYTES + 1, 3 * ROUTER_MAX_BYTES)
"""One that the filter drops, and one that is not even put together."""


@pytest.fixture(params=sampled("on", "off"))
def endpoint(request: pytest.FixtureRequest, certificates: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """A router, with access control and without."""
    monkeypatch.setenv("ZARM_SECURITY", request.param)
    monkeypatch.setenv("ZARM_CERTS", str(certificates))
    with router() as place:
        yield place


def test_what_is_published_arrives_up_to_the_limit(endpoint: str) -> None:
    arrived: list[int] = []
    with open_client(endpoint, role="executor") as sender, open_client(endpoint, role="viewer") as receiver:
        receiver.declare_subscriber(KEYS.driver_command, lambda sample: arrived.append(len(sample.payload)))
        list(receiver.get(KEYS.executor_state))  # the router knows of the subscriber by now
        for length in (*LONGER, ROUTER_MAX_BYTES):
            sender.put(KEYS.driver_command, bytes(length), congestion_control=zenoh.CongestionControl.BLOCK)
        eventually(lambda: arrived, "the longest message arrives")
    assert arrived == [ROUTER_MAX_BYTES]


@pytest.mark.slow
def test_requests_and_answers_arrive_up_to_the_limit(endpoint: str) -> None:
    asked: list[int] = []

    def answer(query: zenoh.Query) -> None:
        asked.append(len(query.payload or b""))
        query.reply(KEYS.stop, bytes(int(str(query.parameters))))

    with open_client(endpoint, role="executor") as service, open_client(endpoint, role="operator") as client:
        service.declare_queryable(KEYS.stop, answer)
        list(service.get(KEYS.executor_state))

        def lengths(request: int, reply: int) -> list[int]:
            replies = client.get(f"{KEYS.stop}?{reply}", payload=bytes(request), timeout=10)
            return [len(one.ok.payload) for one in replies if one.ok]

        assert lengths(ROUTER_MAX_BYTES, ROUTER_MAX_BYTES) == [ROUTER_MAX_BYTES]
        for length in LONGER:
            assert lengths(1, length) == []
        asked.clear()
        for length in LONGER:
            assert lengths(length, 1) == []
        assert asked == []


def test_a_request_too_large_for_the_router_is_refused_at_once(endpoint: str) -> None:
    request = ExecuteRequest.model_construct(plan_id="p" * MAX_BYTES)
    with Bus(endpoint, role="operator") as bus, pytest.raises(InvalidRequest, match="over the limit"):
        bus.call(KEYS.execute, request, timeout=60)
