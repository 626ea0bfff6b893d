"""Storms: several client processes of many threads each, which ask a service everything at once and keep every answer."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

from support.harness import PATIENCE
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


class Storm:
    """`processes` clients of `threads` each, ready in `with`; `let_loose` deals the requests out to them."""

    def __init__(self, endpoint: str, *, processes: int = 4, threads: int = 25) -> None:
        self._command = [sys.executable, str(PROGRAMS / "storm_client.py"), endpoint, str(threads)]
        self._count = processes

    def __enter__(self) -> Self:
        self._processes = [
            subprocess.Popen(self._command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
            for _ in range(self._count)
        ]
        for process in self._processes:
            assert process.stdout is not None
            assert process.stdout.readline() == "ready\n"
        return self

    def __exit__(self, *_: object) -> None:
        for process in self._processes:
            process.kill()
            process.communicate()

    def let_loose(self, requests: Sequence[tuple[str, Message]]) -> list[Answer]:
        """Ask all of this at once; every answer, in the order of the requests. Fails where one has none or several."""
        lines = [json.dumps([number, key, encode(request).decode()]) for number, (key, request) in enumerate(requests)]
        for place, process in enumerate(self._processes):
            assert process.stdin is not None
            process.stdin.write("\n".join([*lines[place :: self._count], "", ""]))
            process.stdin.flush()
        told: dict[int, tuple[str, str]] = {}
        for process in self._processes:
            assert process.stdout is not None
            for line in process.stdout:
                number, kind, text = json.loads(line)
                assert number not in told, f"two answers to {requests[number]}"
                told[number] = kind, text
            assert process.wait(PATIENCE) == 0
        assert sorted(told) == list(range(len(requests)))
        return [_answer(*requests[number], *told[number]) for number in range(len(requests))]


def storm(endpoint: str, requests: Sequence[tuple[str, Message]]) -> list[Answer]:
    """A whole storm and its answers."""
    with Storm(endpoint) as clients:
        return clients.let_loose(requests)


def _answer(key: str, request: Message, kind: str, text: str) -> Answer:
    problem = decode(Problem, text.encode()) if kind == "problem" else None
    return Answer(key, request, "" if problem else text, problem)
