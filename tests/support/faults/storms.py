"""Storms: several client processes with many threads each, which ask a service everything at once and keep every
answer.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass

from support.client_processes import ClientProcesses
from support.paths import PROGRAMS
from zarm_contract.codec import decode, encode
from zarm_contract.errors import Problem
from zarm_contract.messages import Message


@dataclass(frozen=True)
class Answer:
    """What came back: `problem`, or the `reply` as JSON."""

    key: str
    request: Message
    reply: str
    problem: Problem | None

    @property
    def code(self) -> str:
        """The problem's code, `ok` without one."""
        return "ok" if self.problem is None else self.problem.code


class Storm(ClientProcesses):
    """`processes` clients of `threads` each."""

    def __init__(self, endpoint: str, *, processes: int = 4, threads: int = 25) -> None:
        super().__init__(PROGRAMS / "storm_client.py", endpoint, str(threads), count=processes)

    def let_loose(self, requests: Sequence[tuple[str, Message]]) -> list[Answer]:
        """Send all of this at once; returns every answer, in the order of the requests. Fails if one has none or
        several.
        """
        lines = [json.dumps([number, key, encode(request).decode()]) for number, (key, request) in enumerate(requests)]
        reported: dict[int, tuple[str, str]] = {}
        for answer in self.ask_at_once(lines):
            number, kind, text = json.loads(answer)
            assert number not in reported, f"two answers to {requests[number]}"
            reported[number] = kind, text
        assert sorted(reported) == list(range(len(requests)))
        return [_answer(*requests[number], *reported[number]) for number in range(len(requests))]


def storm(endpoint: str, requests: Sequence[tuple[str, Message]]) -> list[Answer]:
    """A whole storm and its answers."""
    with Storm(endpoint) as clients:
        return clients.let_loose(requests)


def _answer(key: str, request: Message, kind: str, text: str) -> Answer:
    problem = decode(Problem, text.encode()) if kind == "problem" else None
    return Answer(key, request, "" if problem else text, problem)
