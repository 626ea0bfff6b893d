"""A router in a separate process, which can be stalled: `python router_process.py ENDPOINT` until its input ends."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager

from zarm_runtime.session import open_router


class RouterProcess:
    """A running one."""

    def __init__(self, process: subprocess.Popen[str]) -> None:
        self._process = process

    def stall(self) -> None:
        """Nothing passes, silently."""
        os.kill(self._process.pid, signal.SIGSTOP)

    def go_on(self) -> None:
        """Everything that arrived meanwhile passes."""
        os.kill(self._process.pid, signal.SIGCONT)


@contextmanager
def router_process(endpoint: str) -> Iterator[RouterProcess]:
    """A router that listens there."""
    command = [sys.executable, __file__, endpoint]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        try:
            assert process.stdout.readline() == "listening\n"
            yield RouterProcess(process)
        finally:
            process.send_signal(signal.SIGCONT)
            process.stdin.close()
            process.wait()


if __name__ == "__main__":
    with open_router(sys.argv[1]):
        print("listening", flush=True)  # noqa: T201 - its output is its answer
        sys.stdin.read()
