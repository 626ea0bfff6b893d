"""Waits as a process does until it is told to end, and aims signals at the moments at which they could get lost.

    python aimed_signals.py COUNT

Each comes within a tenth of a millisecond of the beginning of a wait or of its timeout. Exits with 1 as soon as a
signal does not end the wait.
"""

from __future__ import annotations

import os
import random
import signal
import sys
import threading

from zarm_runtime import signals

WAIT = 0.0005  # s
SPREAD = 0.0001  # s
PATIENCE = 20.0  # s without any progress


def main(count: int) -> None:
    signals.expect()
    signal.signal(signal.SIGALRM, lambda number, _: signals.received.append(number))
    progress = threading.Event()

    def watch() -> None:
        while progress.wait(PATIENCE):
            progress.clear()
        os.write(2, b"lost\n")
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
    aim = random.Random(0)
    for number in range(count):
        signals.received.clear()
        moment = aim.choice((SPREAD, WAIT)) + aim.uniform(-SPREAD, SPREAD)
        signal.setitimer(signal.ITIMER_REAL, max(moment, 1e-6))
        signals.wait(WAIT)
        while not signals.received:
            signals.wait()
        if number % 100 == 0:
            progress.set()


if __name__ == "__main__":
    main(int(sys.argv[1]))
