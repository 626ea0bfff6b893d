"""A stop wins over everything that was sent before it, however long that waited, whatever it is and whoever sent it."""

from __future__ import annotations

import os
import signal

import pytest
import zenoh

from support.executor.client import Client
from support.harness import PATIENCE, ServiceProcess, eventually
from support.tiers import sampled
from support.trajectories import KEYS, moved, rest_to_rest
from zarm_contract.codec import decode, encode
from zarm_contract.errors import Problem
from zarm_contract.messages import (
    Accepted,
    ExecuteRequest,
    ExecutorState,
    GoalState,
    Message,
    Nothing,
    StrategyRequest,
    StreamChunk,
)
from zarm_runtime.session import open_client

ROUNDS = int(os.environ.get("ORDER_ROUNDS", "4"))
"""How often each is tried."""
GOAL = moved(0.4)


class Requester:
    """Sends queries without waiting for their answers."""

    def __init__(self, session: zenoh.Session) -> None:
        self._session = session
        self._answers: dict[str, zenoh.Reply] = {}

    def ask(self, key: str, request: Message) -> None:
        self._session.get(
            key, lambda reply: self._answers.setdefault(key, reply), payload=encode(request), timeout=PATIENCE
        )

    def answer(self, key: str, model: type[Message]) -> Message:
        """The answer to the last request on this key, or the Problem."""
        reply = eventually(lambda: self._answers.pop(key, None), f"{key} is answered")
        if reply.ok is not None:
            return decode(model, reply.ok.payload.to_bytes())
        assert reply.err is not None
        return decode(Problem, reply.err.payload.to_bytes())

    def passed_on(self) -> None:
        """Wait until the router has passed on all that was sent: it takes one after the other."""
        list(self._session.get("zarm/nobody/at/all", timeout=PATIENCE))


def execute_of(samples: int) -> ExecuteRequest:
    """A motion of 5 s, or so, in so many samples: the more the longer it takes to read."""
    return ExecuteRequest(trajectory=rest_to_rest(GOAL, slower=3.0, dt=5.0 / samples))


def stays_where_it_was_stopped(client: Client, execute: Message) -> None:
    """The motion was refused, or the stop ended it: it does not go on."""
    if isinstance(execute, Problem):
        assert execute.code == "cancelled", execute
    else:
        assert isinstance(execute, Accepted)
        assert client.ended(execute.goal_id).status == "cancelled"
    assert client.mode("idle").goal_id is None
    eventually(client.stands, "the robot stands")  # what was measured before may still come


@pytest.mark.parametrize("samples", sampled(200, 50, 3000, 16000))
def test_an_execute_sent_before_a_stop_does_not_start_after_it(
    executor: ServiceProcess, client: Client, endpoint: str, samples: int
) -> None:
    with open_client(endpoint) as session:
        requester = Requester(session)
        for _ in range(ROUNDS):
            where = client.position()
            requester.ask(KEYS.execute, execute_of(samples))
            requester.ask(KEYS.stop, Nothing())
            stopped = requester.answer(KEYS.stop, ExecutorState)
            execute = requester.answer(KEYS.execute, Accepted)
            stays_where_it_was_stopped(client, execute)
            if isinstance(stopped, ExecutorState) and stopped.mode == "idle":
                assert (client.position() == where).all()


@pytest.mark.parametrize("samples", sampled(3000, 50))
def test_a_thawed_executor_handles_messages_in_order_of_arrival(
    executor: ServiceProcess, client: Client, endpoint: str, samples: int
) -> None:
    with open_client(endpoint) as one, open_client(endpoint) as other:
        first, second = Requester(one), Requester(other)
        for _ in range(ROUNDS):
            where = client.position()
            os.kill(executor.process.pid, signal.SIGSTOP)
            first.ask(KEYS.execute, execute_of(samples))
            first.passed_on()
            second.ask(KEYS.stop, Nothing())
            second.passed_on()
            os.kill(executor.process.pid, signal.SIGCONT)
            second.answer(KEYS.stop, ExecutorState)
            stays_where_it_was_stopped(client, first.answer(KEYS.execute, Accepted))
            assert abs(client.position() - where).max() < 0.01  # a tick or two, where it had begun


def test_a_stream_sent_before_a_stop_does_not_begin_after_it(
    executor: ServiceProcess, client: Client, endpoint: str
) -> None:
    with open_client(endpoint) as session:
        requester = Requester(session)
        for number in range(ROUNDS):
            trajectory = rest_to_rest(GOAL, slower=3.0, dt=5.0 / 3000)
            chunk = StreamChunk(goal_id=f"s-{number}", sequence=1, start=0.0, trajectory=trajectory, deadline=0.5)
            session.put(KEYS.stream, encode(chunk))
            requester.ask(KEYS.stop, Nothing())
            requester.answer(KEYS.stop, ExecutorState)

            def ended(name: str = f"s-{number}") -> GoalState | None:
                return next((goal for goal in client.goals if goal.goal_id == name and goal.done), None)

            assert eventually(ended, "the stream has ended").status == "cancelled"
            eventually(client.stands, "the robot stands")


def test_a_switch_sent_before_a_stop_is_not_carried_out(
    executor: ServiceProcess, client: Client, endpoint: str
) -> None:
    with open_client(endpoint) as session:
        requester = Requester(session)
        for _ in range(ROUNDS):
            os.kill(executor.process.pid, signal.SIGSTOP)
            requester.ask(KEYS.strategy, StrategyRequest(strategy="ghost"))
            requester.ask(KEYS.stop, Nothing())
            requester.passed_on()
            os.kill(executor.process.pid, signal.SIGCONT)
            stopped = requester.answer(KEYS.stop, ExecutorState)
            assert isinstance(stopped, ExecutorState)
            active = client.strategy().active
            assert active == stopped.strategy, "it was carried out before the stop, or not at all"
            client.strategy("emulator")
