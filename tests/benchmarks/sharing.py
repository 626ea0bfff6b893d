"""What a client waits for a plan beside greedy ones: `python tests/benchmarks/sharing.py [--plans 20]`.

A planner process and a router on loopback. The modest client asks for one plan after the other with `optimize_s` 0; a greedy
one has 18 requests in hand all the time, either with 30 s of optimisation or searches that find nothing in their 60 s. The time
counts until there is a plan: a request that is refused as `busy` is sent again. It is printed as a ratio to that of the modest
client alone in the same scene, so that figures from different machines compare.
"""

from __future__ import annotations

import argparse
import multiprocessing
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

sys.path.insert(0, str(Path(__file__).parents[1]))
from support.harness import PATIENCE, ServiceProcess, router
from support.planner.client import BEHIND_FENCE, BEHIND_POST, FENCE, HOME, KEYS, POST, load, to_joints
from zarm_contract.errors import Busy, ZarmError
from zarm_contract.messages import PlanRequest, WaypointsGoal
from zarm_runtime.bus import Bus

SETTLED = 3.0
"""Seconds until greedy clients have all that they can have in hand."""
MODEST = PlanRequest(start=HOME, goal=to_joints(-0.3, *HOME[1:]), timeout=60.0, optimize_s=0.0)
THERE_AND_BACK = WaypointsGoal(kind="waypoints", through=(to_joints(*BEHIND_POST), to_joints(*HOME)))
GREEDY = {
    "optimisation": ((POST,), PlanRequest(start=HOME, goal=THERE_AND_BACK, timeout=60.0, optimize_s=30.0)),
    "search": (FENCE, PlanRequest(start=HOME, goal=to_joints(*BEHIND_FENCE), timeout=60.0, max_attempts=1000)),
}


def main() -> None:
    """Print one table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--plans", type=int, default=20, help="plans of the modest client beside each")
    options = parser.parse_args()
    table = Table("beside", "greedy clients", "median ms", "longest ms", "longest to alone", "refused")
    with tempfile.TemporaryDirectory() as name, router() as endpoint, Bus(endpoint) as bus:
        measure(bus, endpoint, Path(name), options.plans, table)
    Console(width=120).print(table)


def measure(bus: Bus, endpoint: str, folder: Path, plans: int, table: Table) -> None:
    """A row for each number of greedy clients and each kind of what they ask for."""
    with ServiceProcess("planner", endpoint, folder) as planner:
        planner.wait_ready(bus, KEYS)
        for what, (objects, request) in GREEDY.items():
            load(bus, *objects)
            alone = 0.0
            for clients in (0, 1, 2):
                with greedy(endpoint, request, clients):
                    waited, refused = zip(*(wait(bus) for _ in range(plans)), strict=True)
                longest, median = max(waited), float(np.median(waited))
                alone = alone or median
                row = f"{1e3 * median:.1f}", f"{1e3 * longest:.1f}", f"{longest / alone:.1f}", f"{sum(refused)}"
                table.add_row(what, str(clients), *row)


def wait(bus: Bus) -> tuple[float, int]:
    """Seconds until the modest client has a plan, and how often it was refused."""
    began, refused = time.perf_counter(), 0
    while True:
        try:
            bus.call(KEYS.plan, MODEST, timeout=PATIENCE)
        except Busy:
            refused += 1
            time.sleep(0.05)
        else:
            return time.perf_counter() - began, refused


@contextmanager
def greedy(endpoint: str, request: PlanRequest, clients: int) -> Iterator[None]:
    """So many processes that ask for more all the time; they are killed in the end."""
    spawn = multiprocessing.get_context("spawn")  # no process may be forked with a session open
    processes = [spawn.Process(target=ask_for_ever, args=(endpoint, request)) for _ in range(clients)]
    for process in processes:
        process.start()
    if processes:
        time.sleep(SETTLED)
    try:
        yield
    finally:
        for process in processes:
            process.kill()
            process.join()


def ask_for_ever(endpoint: str, request: PlanRequest) -> None:
    """Have 18 requests in hand, or as many as the planner takes."""
    with Bus(endpoint) as bus:

        def ask() -> None:
            while True:
                try:
                    bus.call(KEYS.plan, request, timeout=2 * PATIENCE)
                except ZarmError:
                    time.sleep(0.05)

        threads = [threading.Thread(target=ask) for _ in range(18)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()


if __name__ == "__main__":
    main()
