"""Many robots on one bus: `python tests/benchmarks/many_arms.py [seconds of motion] [--arms 1 2 4 6 8 10]`.

A router, and for each emulated arm an executor at 100 Hz and a planner, all processes on this machine. For each number of arms:
all plan at once, all execute what they planned at once, and one after the other is asked for its state meanwhile. Then each is
cancelled while the others move.

Prints a table, a line for each number of arms. Lateness is from a tick's deadline to its start; a missed tick is a deadline
that was left out. A joint state's age is from its stamp until another process has it. CPU is of one core, of one arm.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np
import psutil
from rich.console import Console
from rich.table import Table

from zarm_trajectory.arrays import Array

sys.path.insert(0, str(Path(__file__).parents[1]))
from support.harness import PATIENCE, ServiceProcess, eventually, free_endpoint
from support.paths import PROGRAMS
from support.trajectories import HOME, moved
from zarm_contract.keys import Keys
from zarm_contract.messages import (
    CancelRequest,
    ExecuteRequest,
    GoalState,
    JointGoal,
    PlanRequest,
)
from zarm_runtime.bus import Bus
from zarm_runtime.realtime import PROCESS_PRIORITY, ask_for_realtime
from zarm_runtime.session import open_client, open_router

AWAY, BACK = moved(1.0, -0.5, 0.3), HOME
TIMED = str(PROGRAMS / "timed_executor.py")
RATE = 100.0


@dataclass
class Arm:
    """One robot: its services, and where the stop-watch of its executor writes."""

    keys: Keys
    executor: ServiceProcess
    planner: ServiceProcess
    notes: Path


@dataclass
class Result:
    """Of one number of arms; times in s. `window` is on the monotonic clock."""

    arms: int
    window: tuple[float, float]
    plan: Array
    execute: Array
    asked: Array
    cancel: Array
    age: Array
    cpu: dict[str, float]
    memory: dict[str, float]
    machine: float
    succeeded: int
    late: Array = field(default_factory=lambda: np.empty(0))
    missed: int = 0


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("seconds", nargs="?", type=float, default=4.0, help="length of each motion, at least")
    parser.add_argument("--arms", nargs="+", type=int, default=[1, 2, 4, 6, 8, 10], help="how many, rising")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as name, ExitStack() as services:
        folder, endpoint = Path(name), free_endpoint()
        router = services.enter_context(beside(serve_router, endpoint))
        bus = services.enter_context(Bus(endpoint, timeout=PATIENCE))
        arms: list[Arm] = []
        results = []
        for count in options.arms:
            while len(arms) < count:
                arms.append(started(services, f"arm_{len(arms) + 1}", endpoint, folder))
            for arm in arms:
                arm.planner.wait_ready(bus, arm.keys)
                arm.executor.wait_ready(bus, arm.keys)
            with listening(endpoint) as receive:
                results.append(measure(arms, bus, options.seconds, router, receive))
        services.close()
        for arm in arms:
            read_ticks(arm, results)
    show(results)


def started(services: ExitStack, name: str, endpoint: str, folder: Path) -> Arm:
    """An arm of its own, its processes just started."""
    state = folder / name
    state.mkdir()
    notes = state / "notes.npz"
    arguments = ("--strategy", "emulator", "--notes", str(notes))
    executor = ServiceProcess("executor", endpoint, state, name=name, arguments=arguments, script=TIMED)
    planner = ServiceProcess("planner", endpoint, state, name=name)
    return Arm(Keys(name), services.enter_context(executor), services.enter_context(planner), notes)


def measure(
    arms: list[Arm],
    bus: Bus,
    seconds: float,
    router: psutil.Process,
    receive: Callable[[], list[tuple[float, str, bytes]]],
) -> Result:
    """One line of the table."""
    goals: dict[str, GoalState] = {}
    bus.subscribe(Keys.goal("*"), lambda _, goal: goals.update({goal.goal_id: goal}))
    names = ("executor", "planner", "router")
    receive()
    reported: dict[str, Array] = {}

    def all_told() -> bool:
        reported.update({key.split("/")[1]: np.array(json.loads(payload)["position"]) for _, key, payload in receive()})
        return len(reported) == len(arms)

    eventually(all_told, "all joints are told")
    with ThreadPoolExecutor(len(arms)) as pool:

        def each(work: Callable[[Arm], tuple[float, str]]) -> tuple[Array, list[str]]:
            found = list(pool.map(work, arms))
            return np.array([took for took, _ in found]), [what for _, what in found]

        def plan(arm: Arm) -> tuple[float, str]:
            target = BACK if np.max(np.abs(reported[arm.keys.robot] - BACK)) > 0.3 else AWAY
            request = PlanRequest(goal=JointGoal(kind="joints", position=tuple(target)), velocity_scale=0.4)
            took, found = timed(lambda: bus.call(arm.keys.plan, request, timeout=PATIENCE))
            return took, found.plan_id

        planned, plans = each(plan)
        known = dict(zip([arm.keys.robot for arm in arms], plans, strict=True))

        def execute(arm: Arm) -> tuple[float, str]:
            request = ExecuteRequest(plan_id=known[arm.keys.robot])
            took, accepted = timed(lambda: bus.call(arm.keys.execute, request, timeout=PATIENCE))
            return took, accepted.goal_id

        executed, moving = each(execute)
        receive()
        began, before, everything = time.monotonic(), cpu_times(arms, router), psutil.cpu_times()
        asked = []
        while time.monotonic() - began < seconds:
            for arm in arms:
                asked.append(timed(lambda arm=arm: bus.read(arm.keys.executor_state, timeout=PATIENCE))[0])  # type: ignore[misc]
                time.sleep(0.02 / len(arms))
        heard = receive()
        ended, after, everything_after = time.monotonic(), cpu_times(arms, router), psutil.cpu_times()
        cancelled = []
        for arm, goal_id in zip(arms, moving, strict=True):
            cancelled.append(
                timed(
                    lambda arm=arm, goal_id=goal_id: bus.call(
                        arm.keys.cancel, CancelRequest(goal_id=goal_id), timeout=PATIENCE
                    )
                )[0]
            )  # type: ignore[misc]
        eventually(lambda: all(goal in goals and goals[goal].done for goal in moving), "all have ended")
    return Result(
        len(arms),
        (began, ended),
        planned,
        executed,
        np.array(asked),
        np.array(cancelled),
        np.array([at - json.loads(payload)["stamp"] for at, _, payload in heard]),
        {name: (after[name] - before[name]) / (ended - began) / len(arms) for name in names},
        memory(arms, router),
        busy(everything, everything_after),
        sum(goals[goal].progress > 0.1 and goals[goal].status in ("cancelled", "succeeded") for goal in moving),
    )


def timed(work: Callable[[], object]) -> tuple[float, object]:
    """How long it took (s), and what came of it."""
    began = time.monotonic()
    found = work()
    return time.monotonic() - began, found


def cpu_times(arms: list[Arm], router: psutil.Process) -> dict[str, float]:
    """CPU time (s) so far by kind of process."""

    def used(*processes: psutil.Process) -> float:
        times = [process.cpu_times() for process in processes]
        return float(sum(one.user + one.system for one in times))

    return {
        "executor": used(*(psutil.Process(arm.executor.process.pid) for arm in arms)),
        "planner": used(*(psutil.Process(arm.planner.process.pid) for arm in arms)),
        "router": used(router),
    }


def memory(arms: list[Arm], router: psutil.Process) -> dict[str, float]:
    """What each kind takes for itself alone (MiB), the mean; pages that processes share are not counted."""

    def taken(*processes: psutil.Process) -> float:
        return float(np.mean([process.memory_full_info().uss for process in processes])) / 2**20

    return {
        "executor": taken(*(psutil.Process(arm.executor.process.pid) for arm in arms)),
        "planner": taken(*(psutil.Process(arm.planner.process.pid) for arm in arms)),
        "router": taken(router),
    }


def busy(before: object, after: object) -> float:
    """Share of all cores that was at work, whoever's work it was."""
    used = {name: getattr(after, name) - getattr(before, name) for name in ("user", "system", "idle", "iowait")}
    return 1.0 - (used["idle"] + used["iowait"]) / sum(used.values())


def read_ticks(arm: Arm, results: list[Result]) -> None:
    """Add what the stop-watch of an executor noted to the results in whose time it was."""
    deadline, start, _ = np.load(arm.notes)["ticks"].T
    for result in results:
        began, ended = result.window
        inside = (deadline >= began) & (deadline < ended)
        if np.any(inside):
            result.late = np.append(result.late, (start - deadline)[inside])
            result.missed += int(np.sum(np.rint(np.diff(deadline[inside]) * RATE) - 1))


@contextmanager
def listening(endpoint: str) -> Iterator[Callable[[], list[tuple[float, str, bytes]]]]:
    """Another process that hears every joint state; yields how to ask for those since it was last asked."""
    here, there = multiprocessing.Pipe()
    with beside(listen, endpoint, there):
        here.recv()

        def heard() -> list[tuple[float, str, bytes]]:
            here.send("tell")
            answer: list[tuple[float, str, bytes]] = here.recv()
            return answer

        yield heard


def listen(endpoint: str, pipe: Connection) -> None:
    """Note what is heard, and tell it when asked."""
    ask_for_realtime(PROCESS_PRIORITY)
    heard: list[tuple[float, str, bytes]] = []
    with open_client(endpoint) as session:
        session.declare_subscriber(
            "zarm/*/joint_states",
            lambda sample: heard.append((time.time(), str(sample.key_expr), sample.payload.to_bytes())),
        )
        pipe.send("ready")
        while True:
            pipe.recv()
            reported, heard[:] = heard[:], []
            pipe.send(reported)


@contextmanager
def beside(work: Callable[..., None], *arguments: object) -> Iterator[psutil.Process]:
    """Another process."""
    process = multiprocessing.get_context("spawn").Process(target=work, args=arguments)
    process.start()
    try:
        yield psutil.Process(process.pid)
    finally:
        process.terminate()
        process.join()


def serve_router(endpoint: str) -> None:
    """A router until the process ends."""
    with open_router(endpoint):
        threading.Event().wait()


def show(results: list[Result]) -> None:
    """The tables."""
    table = Table(
        "arms",
        "late, ms",
        "missed",
        "joint state's age, ms",
        "a second, of each",
        "plan, ms",
        "execute, ms",
        "state, ms",
        "cancel, ms",
        "moved",
        title="p50 / p99 / max",
    )
    load = Table(
        "arms",
        "executor CPU",
        "planner CPU",
        "router CPU by arm",
        "all cores",
        "executor MiB",
        "planner MiB",
        "router MiB",
    )
    for r in results:
        missed = f"{r.missed} of {len(r.late) + r.missed}"
        rate = len(r.age) / (r.window[1] - r.window[0]) / r.arms
        table.add_row(
            str(r.arms),
            cell(r.late),
            missed,
            cell(r.age),
            f"{rate:.1f}",
            *(cell(column) for column in (r.plan, r.execute, r.asked, r.cancel)),
            f"{r.succeeded}",
        )
        load.add_row(
            str(r.arms),
            *(f"{r.cpu[name]:.1%}" for name in ("executor", "planner", "router")),
            f"{r.machine:.0%}",
            *(f"{r.memory[name]:.0f}" for name in ("executor", "planner", "router")),
        )
    console = Console(width=180)
    console.print(table)
    console.print(load)


def cell(seconds: Array) -> str:
    return " / ".join(f"{1e3 * value:.2f}" for value in np.percentile(seconds, (50, 99, 100))) if len(seconds) else ""


if __name__ == "__main__":
    main()
