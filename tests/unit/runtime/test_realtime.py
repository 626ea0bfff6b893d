"""Real-time priority, tried in processes of its own: this machine may allow it or not."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from support.harness import free_endpoint

ALLOWED = (
    "from zarm_runtime.realtime import *\n"
    "import os, sys\n"
    "def of_threads():\n"
    "    return {int(tid): os.sched_getscheduler(int(tid)) for tid in os.listdir('/proc/self/task')}\n"
)
FORBIDDEN = (
    "import os, resource\n"
    "resource.setrlimit(resource.RLIMIT_RTPRIO, (0, 0))\n"
    "if os.geteuid() == 0:\n"
    "    os.setuid(65534)\n"
)


def run(program: str, *arguments: str) -> list[str]:
    command = [sys.executable, "-c", program, *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout.split()


def test_without_permission_for_priority_nothing_fails() -> None:
    program = (
        f"{ALLOWED}{FORBIDDEN}"
        "print(ask_for_realtime(PROCESS_PRIORITY))\n"
        "with realtime_offspring(PROCESS_PRIORITY):\n"
        "    print(set(of_threads().values()) == {os.SCHED_OTHER})\n"
    )
    assert run(program) == ["False", "True"]


def test_a_router_s_threads_have_priority_and_its_owner_not() -> None:
    program = (
        f"{ALLOWED}"
        "from zarm_runtime.session import open_router\n"
        "before = of_threads()\n"
        "with open_router(sys.argv[1]):\n"
        "    threads = of_threads()\n"
        "    print(threads[os.getpid()] == os.SCHED_OTHER)\n"
        "    print(os.SCHED_RR in [policy for tid, policy in threads.items() if tid not in before])\n"
        "print(ask_for_realtime(PROCESS_PRIORITY))\n"
    )
    ordinary, preferred, allowed = run(program, free_endpoint())
    assert ordinary == "True"
    assert preferred == allowed


@pytest.mark.skipif(
    not hasattr(os, "sched_setscheduler"), reason="this system knows no real-time priority for a thread"
)
def test_priority_reaches_every_thread_of_the_process() -> None:
    program = (
        f"{ALLOWED}"
        "import threading\n"
        "wanted = os.SCHED_RR if ask_for_realtime(PROCESS_PRIORITY) else os.SCHED_OTHER\n"
        "threading.Thread(target=lambda: print(os.sched_getscheduler(0) == wanted)).start()\n"
    )
    assert run(program) == ["True"]
