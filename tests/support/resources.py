"""What service processes take of the machine, and that they get it."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

import psutil

from support.harness import ServiceProcess

PRIORITY = 10
"""A real-time priority, above every ordinary thread."""


@dataclass(frozen=True)
class Burden:
    """Threads, open descriptors and resident memory (bytes) of one process."""

    threads: int
    descriptors: int
    memory: int

    def __str__(self) -> str:
        return f"{self.threads} threads, {self.descriptors} descriptors, {self.memory / 2**20:.1f} MiB"


def burden(service: ServiceProcess) -> Burden:
    """Of a running service, now."""
    process = psutil.Process(service.process.pid)
    return Burden(process.num_threads(), process.num_fds(), process.memory_info().rss)


@contextmanager
def ahead_of_others() -> Iterator[None]:
    """Threads and processes begun in the block go before every ordinary one, where the system lets them.

    So that what else this machine does is not among the faults.
    """
    policy, parameters = os.sched_getscheduler(0), os.sched_getparam(0)
    with suppress(PermissionError):
        os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(1))
    try:
        yield
    finally:
        os.sched_setscheduler(0, policy, parameters)


def favour(*services: ServiceProcess) -> None:
    """Let these, and this process's router, go before what else runs on the machine, where that is allowed.

    A robot has a computer of its own. The thread that asks is left out, because what it starts would be favoured as well.
    """
    tasks = [int(task.name) for task in Path("/proc/self/task").glob("*") if int(task.name) != os.getpid()]
    for service in services:
        tasks += [int(task.name) for task in Path(f"/proc/{service.process.pid}/task").glob("*")]
    for task in tasks:
        try:
            os.sched_setscheduler(task, os.SCHED_RR, os.sched_param(PRIORITY))
        except (PermissionError, ProcessLookupError):
            continue
