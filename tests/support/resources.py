"""The machine's resources used by service processes, and their priority."""

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
    """The resources of a running service, now."""
    process = psutil.Process(service.process.pid)
    return Burden(process.num_threads(), process.num_fds(), process.memory_info().rss)


@contextmanager
def ahead_of_others() -> Iterator[None]:
    """Threads and processes started in the block take precedence over ordinary ones, if the system permits.

    So the machine's other load is not among the faults.
    """
    policy, parameters = os.sched_getscheduler(0), os.sched_getparam(0)
    with suppress(PermissionError):
        os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(1))
    try:
        yield
    finally:
        os.sched_setscheduler(0, policy, parameters)


def favour(*services: ServiceProcess) -> None:
    """Give these, and this process's router, precedence over everything else on the machine, if permitted.

    A robot has a computer of its own. The calling thread is excluded, because whatever it starts would inherit the
    priority.
    """
    tasks = [int(task.name) for task in Path("/proc/self/task").glob("*") if int(task.name) != os.getpid()]
    for service in services:
        tasks += [int(task.name) for task in Path(f"/proc/{service.process.pid}/task").glob("*")]
    for task in tasks:
        try:
            os.sched_setscheduler(task, os.SCHED_RR, os.sched_param(PRIORITY))
        except (PermissionError, ProcessLookupError):
            continue
