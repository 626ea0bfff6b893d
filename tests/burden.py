"""What service processes take of the machine, and that they get it."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import psutil
from harness import ServiceProcess

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
