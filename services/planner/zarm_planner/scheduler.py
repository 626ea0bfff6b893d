"""Schedules requests: how many run at once, which is next, and how one is cancelled."""

from __future__ import annotations

import threading
import time
from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TypeVar

from zarm_contract.errors import Cancelled, Unavailable
from zarm_contract.messages import Requester
from zarm_planner.deadline import Deadline

T = TypeVar("T")

LONG = 1.0
"""Seconds after which work no longer blocks its slot for other clients, and continues beside what starts next."""
WITHDRAWN_S = 10.0
"""Seconds for which a cancel that came before its request is remembered: longer than a request is on its way."""
WITHDRAWN = 1000
"""Most such cancels, and most clients that have left, to remember."""

_POLL = 0.02
"""Interval (s) at which waiting work checks its deadline and its turn."""


@dataclass(eq=False)
class _Job:
    """Work that waits for its turn since `since`, or that `began` (s, monotonic)."""

    client: str
    request_id: str | None
    deadline: Deadline
    since: float = field(default_factory=time.monotonic)
    began: float | None = None
    turn: threading.Lock = field(default_factory=threading.Lock)
    """Held until its turn has come."""

    def __post_init__(self) -> None:
        self.turn.acquire()


class Scheduler:
    """Runs as much work at a time as there are `slots`, each in the thread that asks for it.

    The next turn goes to the client with the least running work, and among equals to the one that has waited longest;
    no client runs more than `slots` at a time. Waiting work has its deadline and can be cancelled.

    `is_there` tells whether a client that had left is back.
    """

    def __init__(self, slots: int, is_there: Callable[[str], bool]) -> None:
        self._slots = slots
        self._is_there = is_there
        self._changed = threading.Condition()
        self._jobs: list[_Job] = []
        self._withdrawn: deque[tuple[str, float]] = deque(maxlen=WITHDRAWN)
        self._left: dict[str, None] = {}
        self._closed = False

    def run(
        self, work: Callable[[Deadline], T], requester: Requester, timeout: float, request_id: str | None = None
    ) -> T:
        """The result of `work(deadline)`, which must observe the deadline. Raises Unavailable once the service ends.

        The deadline is `timeout` s from now, or when the requester stops waiting.
        """
        job = _Job(requester.client, request_id, Deadline(min(timeout, requester.timeout)))
        with self._changed:
            if self._closed:
                raise _ending()
            if self._was_withdrawn(request_id):
                job.deadline.cancel()
            has_left = job.client in self._left
            self._jobs.append(job)
            self._start_next()
        try:
            if has_left and self._is_there(job.client):
                self._left.pop(job.client, None)
            elif has_left:  # the notice that the client left arrived before its last requests
                job.deadline.cancel()
            while not job.turn.acquire(timeout=_POLL):
                job.deadline.check()
                self._press(job)
            job.deadline.check()
            return work(job.deadline)
        except Cancelled as error:
            if self._closed:
                raise _ending() from error
            raise
        finally:
            with self._changed:
                self._jobs.remove(job)
                self._start_next()
                self._changed.notify_all()

    def cancel(self, request_id: str) -> bool:
        """End the work under this id; returns whether there was any. If not, it is ended when it arrives."""
        with self._changed:
            jobs = [job for job in self._jobs if job.request_id == request_id]
            if not jobs:
                self._withdrawn.append((request_id, time.monotonic()))
            for job in jobs:
                job.deadline.cancel()
            return bool(jobs)

    def leave(self, client: str) -> None:
        """End all work for a client, and requests from it that arrive before it is back."""
        with self._changed:
            self._left[client] = None
            if len(self._left) > WITHDRAWN:
                del self._left[next(iter(self._left))]
            for job in self._jobs:
                if job.client == client:
                    job.deadline.cancel()

    def close(self) -> None:
        """Refuse new work, end all current work, and wait until it has ended."""
        with self._changed:
            self._closed = True
            for job in self._jobs:
                job.deadline.cancel()
            self._changed.wait_for(lambda: not self._jobs)

    def _was_withdrawn(self, request_id: str | None) -> bool:
        """Whether a cancel came before this request; this uses the cancel up."""
        now = time.monotonic()
        while self._withdrawn and self._withdrawn[0][1] < now - WITHDRAWN_S:
            self._withdrawn.popleft()
        found = next((entry for entry in self._withdrawn if entry[0] == request_id), None)
        if found is not None:
            self._withdrawn.remove(found)
        return found is not None

    def _start_next(self) -> None:
        """Give a turn to all work that may have one now."""
        now = time.monotonic()
        while waiting := [job for job in self._jobs if job.began is None]:
            running = [job.began for job in self._jobs if job.began is not None]
            if sum(began > now - LONG for began in running) >= self._slots:
                return
            running_of = self._running_by_client()
            waiting = [job for job in waiting if running_of[job.client] < self._slots]
            if not waiting:
                return
            chosen = min(waiting, key=lambda job: (running_of[job.client], job.since))
            chosen.began = now
            chosen.turn.release()
            for job in waiting:
                if job.client == chosen.client:
                    job.since = now

    def _press(self, waiting: _Job) -> None:
        """Make work that only looks for faster motions give way to waiting work: of the same client, and of clients
        running more.
        """
        with self._changed:
            if waiting.began is not None:  # its turn has just come
                return
            running_of = self._running_by_client()
            for job in self._jobs:
                if job.began is not None and (
                    job.client == waiting.client or running_of[job.client] > running_of[waiting.client]
                ):
                    job.deadline.give_way()
            self._start_next()  # running work may just have become long

    def _running_by_client(self) -> Counter[str]:
        """The number of running jobs of each client."""
        return Counter(job.client for job in self._jobs if job.began is not None)


def _ending() -> Unavailable:
    return Unavailable("the planner is shutting down; ask again once it runs")
