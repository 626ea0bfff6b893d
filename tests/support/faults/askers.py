"""Clients that ask continuously while something is replaced: each answer must be right, or `unavailable`."""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from support.harness import PATIENCE, eventually
from zarm_contract.errors import Unavailable


class Askers:
    """`answers` counts the results of each question: `right`, `unavailable`, or anything else, which is wrong."""

    def __init__(self, questions: dict[str, Callable[[], bool]]) -> None:
        self._questions = questions
        self._ended = threading.Event()
        self.answers: dict[str, Counter[str]] = {name: Counter() for name in questions}
        self.threads = [threading.Thread(target=self._ask, args=(name,)) for name in questions]

    def _ask(self, name: str) -> None:
        while not self._ended.wait(0.03):
            try:
                outcome = "right" if self._questions[name]() else "wrong"
            except Unavailable:
                outcome = "unavailable"
            except Exception as error:
                outcome = repr(error)
            self.answers[name][outcome] += 1

    def end(self) -> None:
        self._ended.set()
        for thread in self.threads:
            thread.join(PATIENCE)

    def all_right_again(self) -> None:
        """Wait until each has a right answer to a question asked from now on."""
        before = {name: counts["right"] for name, counts in self.answers.items()}
        eventually(
            lambda: all(counts["right"] > before[name] + 1 for name, counts in self.answers.items()),
            f"all are answered again: {self.answers}",
        )


@contextmanager
def asking(**questions: Callable[[], bool]) -> Iterator[Askers]:
    """Ask from before the block to its end; fails if an answer was neither right nor `unavailable`."""
    askers = Askers(questions)
    for thread in askers.threads:
        thread.start()
    try:
        askers.all_right_again()
        yield askers
    finally:
        askers.end()
    wrong = {name: counts for name, counts in askers.answers.items() if set(counts) - {"right", "unavailable"}}
    assert not wrong, wrong
