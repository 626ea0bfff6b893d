"""Many client processes with simultaneous requests: all of them are ready before the first one asks."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Self

from support.harness import PATIENCE


class ClientProcesses:
    """`count` processes of a program, ready in `with`.

    The program says `ready`. It reads requests, one a line up to an empty line, and sends all of them at once; it
    writes answers, one a line, and an empty line after the last. It repeats this until its input ends.
    """

    def __init__(self, program: Path, *arguments: str, count: int) -> None:
        self._command = [sys.executable, str(program), *arguments]
        self._count = count

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
        """End them: half of them regularly, half by a crash."""
        for place, process in enumerate(self._processes):
            if place % 2:
                process.kill()
            process.communicate(timeout=PATIENCE)

    def ask_at_once(self, requests: Sequence[str] = ()) -> list[str]:
        """Distribute the requests over the processes, and let all of them ask; returns every answer line."""
        for place, process in enumerate(self._processes):
            assert process.stdin is not None
            process.stdin.writelines(f"{line}\n" for line in [*requests[place :: self._count], ""])
            process.stdin.flush()
        answers: list[str] = []
        for process in self._processes:
            assert process.stdout is not None
            for line in iter(process.stdout.readline, "\n"):
                assert line, f"{process.args} has ended before it had answered everything"
                answers.append(line)
        return answers
