"""The executor with timing, for benchmarks: `python timed_executor.py --notes FILE [--ordinary] ...` and its own
options.

At its end it writes FILE (npz): `ticks` (N, 3) with each tick's deadline, the time at which it began, and its CPU time;
`commands` (M, 2) with the sequence number of each driver command and the time before it was published; `states` (K,)
with the delay (s) of each joint state from the driver's stamp until it was received. Times in s on the monotonic clock,
which all processes of one machine share. `--ordinary` leaves the priority of the control loop unchanged.
"""

from __future__ import annotations

import sys
import time
from array import array
from pathlib import Path

import numpy as np

import zarm_executor.loop
import zarm_executor.service
from zarm_contract.messages import DriverCommand
from zarm_executor.strategies.base import Measured
from zarm_executor.strategies.driver_link import DriverLink
from zarm_runtime.realtime import PROCESS_PRIORITY, ask_for_realtime
from zarm_runtime.service import run_service, service_parser

ticks = array("d")
commands = array("d")
states = array("d")


class TimedControl(zarm_executor.service.Control):
    """Records when each tick begins, and its cost."""

    def tick(self, now: float) -> None:
        began, used = time.monotonic(), time.thread_time()
        super().tick(now)
        ticks.extend((now, began, time.thread_time() - used))


def timed(put):  # type: ignore[no-untyped-def]
    """Records when each command is sent."""

    def noted(link: DriverLink, command: DriverCommand) -> int:
        commands.extend((command.sequence, time.monotonic()))
        return int(put(link, command))

    return noted


def noted(measured):  # type: ignore[no-untyped-def]
    """Records the age of each joint state on arrival."""

    def note(link: DriverLink) -> Measured | None:
        before, state = link._measured, measured(link)
        if state is not None and state is not before:
            states.append(time.time() - (time.monotonic() - state.time) - state.stamp)
        return state

    return note


def main() -> int:
    parser = service_parser("executor")
    parser.add_argument("--strategy")
    parser.add_argument("--notes", type=Path, required=True)
    parser.add_argument("--ordinary", action="store_true")
    options = parser.parse_args()
    zarm_executor.service.Control = TimedControl  # type: ignore[misc]
    DriverLink._put = timed(DriverLink._put)  # type: ignore[method-assign]
    DriverLink.measured = noted(DriverLink.measured)  # type: ignore[method-assign]
    if options.ordinary:
        zarm_executor.loop.ask_for_realtime = lambda _: True
    else:
        ask_for_realtime(PROCESS_PRIORITY)
    code = run_service("executor", parser, zarm_executor.service.start)
    sent = np.array(commands).reshape(-1, 2)
    np.savez(options.notes, ticks=np.array(ticks).reshape(-1, 3), commands=sent, states=np.array(states))
    return code


if __name__ == "__main__":
    sys.exit(main())
