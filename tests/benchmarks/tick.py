"""How late the executor's 100 Hz control loop is: `python tests/benchmarks/tick.py [seconds]`.

Runs the whole executor in this process on a router of another one. Lateness is the time from a tick's deadline to its
start; missed ticks are deadlines left out. The ratio compares the 99th percentile with a bare loop that does nothing.
"""
# ruff: noqa: T201  printing is what a benchmark does

from __future__ import annotations

import argparse
import multiprocessing
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))
from harness import free_endpoint
from motions import KEYS, ROBOT, moved, rest_to_rest

import zarm_executor.service
from zarm_contract.bus import Bus
from zarm_contract.errors import ZarmError
from zarm_contract.messages import Accepted, CancelRequest, ExecuteRequest, ExecutorState
from zarm_contract.service import Service
from zarm_contract.session import open_router
from zarm_executor.follower import TICK
from zarm_executor.loop import Loop
from zarm_executor.service import Control

late: list[float] = []


class TimedControl(Control):
    """Control that notes how late each tick begins."""

    def tick(self, now: float) -> None:
        late.append(time.monotonic() - now)
        super().tick(now)


def serve_router(endpoint: str) -> None:
    with open_router(endpoint):
        threading.Event().wait()


def burn() -> None:
    while True:
        sum(range(1000))


def shout(endpoint: str) -> None:
    """Cancels goals that do not exist, and asks for motions too fast to be allowed, one after the other."""
    refused = ExecuteRequest(trajectory=rest_to_rest(moved(1.0, -0.5, 0.5), slower=0.8))
    with Bus(endpoint) as bus:
        while True:
            bus.call(KEYS.cancel, CancelRequest(goal_id="nobody"), ExecutorState, timeout=5)
            with suppress(ZarmError):
                bus.call(KEYS.execute, refused, Accepted, timeout=5)


@contextmanager
def beside(work: Callable[..., None], *arguments: object, count: int = 1) -> Iterator[None]:
    spawn = multiprocessing.get_context("spawn")
    processes = [spawn.Process(target=work, args=arguments) for _ in range(count)]
    for process in processes:
        process.start()
    try:
        yield
    finally:
        for process in processes:
            process.terminate()
            process.join()


def report(name: str, samples: list[float], missed: int, bare: float) -> float:
    p50, p99, worst = np.percentile(np.array(samples) * 1e6, (50, 99, 100))
    print(f"{name:<34}{p50:9.0f}{p99:9.0f}{worst:9.0f}{missed:9d}{p99 / (bare or p99):9.1f}")
    return float(p99)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("seconds", nargs="?", type=float, default=10.0, help="length of each measurement")
    seconds = parser.parse_args().seconds
    print(f"{'lateness of a tick':<34}{'p50 us':>9}{'p99 us':>9}{'max us':>9}{'missed':>9}{'p99/bare':>9}")

    samples: list[float] = []
    with Loop("bare", TICK, lambda now: samples.append(time.monotonic() - now)):
        time.sleep(seconds)
    bare = report("bare loop", samples, max(0, round(seconds / TICK) - len(samples)), 0.0)

    zarm_executor.service.Control = TimedControl  # type: ignore[misc]
    endpoint = free_endpoint()
    with ExitStack() as stack:
        stack.enter_context(beside(serve_router, endpoint))
        state = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        bus = stack.enter_context(Bus(endpoint, timeout=30.0))
        options = argparse.Namespace(connect=endpoint, state=state, strategy="emulator")
        stack.enter_context(zarm_executor.service.start(Service("executor", ROBOT, KEYS, bus, options)))
        client = stack.enter_context(Bus(endpoint))

        def measure(name: str) -> None:
            before = client_state().missed_ticks
            late.clear()
            time.sleep(seconds)
            report(name, late.copy(), client_state().missed_ticks - before, bare)

        def client_state() -> ExecutorState:
            return client.call(KEYS.cancel, CancelRequest(goal_id="nobody"), ExecutorState, timeout=5)

        measure("idle")
        slow = rest_to_rest(moved(1.0, -0.5, 0.5), slower=20 * seconds, dt=0.1)
        client.call(KEYS.execute, ExecuteRequest(trajectory=slow), Accepted, timeout=5)
        measure("moving")
        with beside(burn):
            measure("moving, a busy process beside")
        with beside(burn, count=multiprocessing.cpu_count()):
            measure("moving, every core busy")
        with beside(shout, endpoint):
            measure("moving, a client that shouts")
        client.call(KEYS.stop, CancelRequest(), ExecutorState, timeout=5)


if __name__ == "__main__":
    main()
