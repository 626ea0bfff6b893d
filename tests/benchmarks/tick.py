"""How steady the executor's control loop is: `python tests/benchmarks/tick.py [seconds of each measurement]`.

The executor, a router, the simulated driver, and beside them a planner whose clients ask for one plan after the other:
processes on one machine. Lateness is the time from a tick's deadline to its start; jitter is how much the time between two
ticks differs from the period, that of ticks left out before it too; a missed tick is a deadline that was left out, and
lateness is against the last deadline. A command's latency is from before it is published by the executor until another
process has it, a joint state's from the driver's stamp until the executor has it.
"ordinary" is without real-time priority, as where it is not allowed, of the executor, the driver and the other process.

Prints tables and draws them into docs/images/tick.png. Needs no more than a minute and a half.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from pathlib import Path

import matplotlib as mpl
import numpy as np
import psutil
from rich.console import Console
from rich.table import Table

from zarm_trajectory.arrays import Array

sys.path.insert(0, str(Path(__file__).parents[1]))
from support.harness import PATIENCE, ServiceProcess, eventually, free_endpoint
from support.paths import PROGRAMS
from support.planner.client import BEHIND_POST, HOME, POST, SHELF, TABLE, load, plan, to_joints
from support.trajectories import KEYS, descriptor_at, moved, rest_to_rest
from zarm_contract.codec import decode
from zarm_contract.errors import ExecutionRefused
from zarm_contract.messages import (
    DriverCommand,
    ExecuteRequest,
    PlanRequest,
    Trajectory,
)
from zarm_runtime.bus import Bus
from zarm_runtime.realtime import PROCESS_PRIORITY, ask_for_realtime
from zarm_runtime.session import open_client, open_router

mpl.use("Agg")
from matplotlib import pyplot as plt

PLOT = Path(__file__).parents[2] / "docs" / "images" / "tick.png"
CLIENTS = 2 * (os.cpu_count() or 1)
"""Clients of the planner: more than it needs to be busy all the time."""
WARM_UP = 1.0
"""Seconds of motion before a measurement."""


@dataclass(frozen=True)
class Case:
    """One executor: its rate in Hz, its strategy, whether a planner works beside it, and with which priority it runs."""

    rate: float
    strategy: str
    planner: bool
    realtime: bool

    def __str__(self) -> str:
        priority = "real-time" if self.realtime else "ordinary"
        return f"{self.rate:g} Hz, {self.strategy}, {'planner at work' if self.planner else 'alone'}, {priority}"


CASES = (
    Case(250, "emulator", planner=False, realtime=True),
    *(Case(rate, "emulator", planner=True, realtime=True) for rate in (100, 250, 500)),
    Case(250, "emulator", planner=True, realtime=False),
    Case(250, "joint_speed", planner=False, realtime=True),
    Case(250, "joint_speed", planner=True, realtime=True),
    Case(250, "joint_speed", planner=True, realtime=False),
)


@dataclass
class Heard:
    """What another process hears: commands as raw payloads, and when they came, on the monotonic clock."""

    commands: list[tuple[float, bytes]] = field(default_factory=list)


@dataclass
class Result:
    """One measurement; times in s."""

    case: Case
    mode: str
    late: Array
    jitter: Array
    work: Array
    missed: int
    cpu: float
    planner_cpu: float
    plans: float
    command_latency: Array
    state_latency: Array


def main() -> None:
    """Print the tables and draw the plot."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("seconds", nargs="?", type=float, default=4.0, help="length of each measurement")
    seconds = parser.parse_args().seconds
    results = []
    with tempfile.TemporaryDirectory() as name, ExitStack() as stack:
        folder, endpoint = Path(name), free_endpoint()
        stack.enter_context(beside(serve_router, endpoint))
        bus = stack.enter_context(Bus(endpoint, timeout=PATIENCE))
        planner = stack.enter_context(ServiceProcess("planner", endpoint, folder))
        planner.wait_ready(bus, KEYS)
        load(bus, TABLE, POST, SHELF)
        for case in CASES:
            results.append(measure(case, seconds, bus, endpoint, folder, planner))
    show(results)
    draw(results)


def measure(case: Case, seconds: float, bus: Bus, endpoint: str, folder: Path, planner: ServiceProcess) -> Result:
    """Run one case."""
    state = Path(tempfile.mkdtemp(dir=folder))
    notes = state / "notes.npz"
    with ExitStack() as stack:
        if case.strategy != "emulator":
            driver = stack.enter_context(ServiceProcess("leeloo_sim", endpoint, state))
            driver.wait_ready(bus, KEYS)
            if case.realtime:
                prefer(driver)
        executor = stack.enter_context(timed_executor(case, endpoint, state, notes))
        executor.wait_ready(bus, KEYS)
        receive = stack.enter_context(listening(endpoint, case.realtime))
        plans: list[float] = []
        if case.planner:
            bus.subscribe(KEYS.plans, lambda *_: plans.append(time.monotonic()))
            stack.enter_context(beside(ask_for_plans, endpoint))
            eventually(lambda: len(plans) > CLIENTS, "the planner is at work")
        slow = rest_to_rest(moved(1.0, -0.5, 0.5), slower=10 * (seconds + WARM_UP), dt=0.1)
        eventually(lambda: started(bus, slow), "the motion begins")
        time.sleep(WARM_UP)
        began, before, planned_before = time.monotonic(), cpu_time(executor), cpu_time(planner)
        time.sleep(seconds)
        ended, after, planned_after = time.monotonic(), cpu_time(executor), cpu_time(planner)
        mode = bus.read(KEYS.executor_state, timeout=PATIENCE).mode
        heard = receive()
    written = np.load(notes)
    deadline, start, work = written["ticks"].T
    inside = (deadline >= began) & (deadline < ended)
    return Result(
        case,
        mode,
        late=(start - deadline)[inside],
        jitter=np.abs(np.diff(start[inside]) - 1.0 / case.rate),
        work=work[inside],
        missed=int(np.sum(np.rint(np.diff(deadline[inside]) * case.rate) - 1)),
        cpu=(after - before) / (ended - began),
        planner_cpu=(planned_after - planned_before) / (ended - began),
        plans=sum(began <= at < ended for at in plans) / (ended - began),
        command_latency=command_latency(written["commands"], heard, began, ended),
        state_latency=written["states"],
    )


def started(bus: Bus, trajectory: Trajectory) -> bool:
    """Start a motion; not while the driver is too late with its joints."""
    try:
        bus.call(KEYS.execute, ExecuteRequest(trajectory=trajectory), timeout=PATIENCE)
    except ExecutionRefused:
        return False
    return True


def prefer(service: ServiceProcess) -> None:
    """Give a process that does not ask for it real-time priority, where that is allowed."""
    with suppress(PermissionError):
        for thread in psutil.Process(service.process.pid).threads():
            os.sched_setscheduler(thread.id, os.SCHED_RR, os.sched_param(PROCESS_PRIORITY))


def cpu_time(service: ServiceProcess) -> float:
    """CPU time (s) that a process has used so far."""
    times = psutil.Process(service.process.pid).cpu_times()
    return float(times.user + times.system)


def command_latency(sent: Array, heard: Heard, began: float, ended: float) -> Array:
    """From before a command was published until the other process had it."""
    left = {int(sequence): at for sequence, at in sent if began <= at < ended}
    came = [(decode(DriverCommand, payload).sequence, at) for at, payload in heard.commands]
    return np.array([at - left[sequence] for sequence, at in came if sequence in left])


def timed_executor(case: Case, endpoint: str, state: Path, notes: Path) -> ServiceProcess:
    """The executor of a case, with a stop-watch."""
    robot = str(descriptor_at(case.rate, state / "robot"))
    arguments = ["--strategy", case.strategy, "--notes", str(notes), *([] if case.realtime else ["--ordinary"])]
    script = str(PROGRAMS / "timed_executor.py")
    return ServiceProcess("executor", endpoint, state, robot=robot, arguments=tuple(arguments), script=script)


@contextmanager
def listening(endpoint: str, realtime: bool) -> Iterator[Callable[[], Heard]]:
    """A process that hears what the driver hears; yields how to ask it for that."""
    here, there = multiprocessing.Pipe()
    with beside(listen, endpoint, there, realtime):
        here.recv()

        def heard() -> Heard:
            here.send("tell")
            answer = here.recv()
            assert isinstance(answer, Heard)
            return answer

        yield heard


def listen(endpoint: str, pipe: Connection, realtime: bool) -> None:
    """Note what is heard until asked for it."""
    if realtime:
        ask_for_realtime(PROCESS_PRIORITY)
    heard = Heard()
    with open_client(endpoint) as session:
        session.declare_subscriber(
            KEYS.driver_command, lambda sample: heard.commands.append((time.monotonic(), sample.payload.to_bytes()))
        )
        pipe.send("ready")
        pipe.recv()
    pipe.send(heard)
    pipe.recv()


@contextmanager
def beside(work: Callable[..., None], *arguments: object) -> Iterator[None]:
    """Another process."""
    process = multiprocessing.get_context("spawn").Process(target=work, args=arguments)
    process.start()
    try:
        yield
    finally:
        process.terminate()
        process.join()


def serve_router(endpoint: str) -> None:
    """A router until the process ends."""
    with open_router(endpoint):
        threading.Event().wait()


def ask_for_plans(endpoint: str) -> None:
    """Clients that ask for a way around the post and back, without a break."""
    ways = [
        PlanRequest(goal=to_joints(*goal), start=start) for start, goal in ((HOME, BEHIND_POST), (BEHIND_POST, HOME))
    ]

    def ask() -> None:
        with Bus(endpoint) as bus:
            while True:
                for way in ways:
                    plan(bus, way)

    for _ in range(CLIENTS):
        threading.Thread(target=ask, daemon=True).start()
    threading.Event().wait()


def show(results: list[Result]) -> None:
    """Two tables."""
    columns = (
        "late us",
        "jitter us",
        "jitter p99 / period",
        "missed",
        "tick CPU us",
        "executor CPU",
        "planner CPU",
        "plans/s",
    )
    table = Table("p50 / p99 / max", *columns)
    for r in results:
        share = f"{np.percentile(r.jitter, 99) * r.case.rate:.1%}"
        missed = f"{r.missed} of {len(r.late) + r.missed}"
        load = (f"{r.cpu:.0%}", f"{r.planner_cpu:.0%}", f"{r.plans:.0f}")
        table.add_row(
            str(r.case) + ("" if r.mode == "running" else f" ({r.mode} at the end)"),
            cell(r.late),
            cell(r.jitter),
            share,
            missed,
            cell(r.work),
            *load,
        )
    latency = Table(
        "p50 / p99 / max, us", "command, executor to driver", "joint state, driver to executor", "of so many"
    )
    for r in results:
        if len(r.command_latency):
            counts = f"{len(r.command_latency)}, {len(r.state_latency)}"
            latency.add_row(str(r.case), cell(r.command_latency), cell(r.state_latency), counts)
    console = Console(width=180)
    console.print(table)
    console.print(latency)


def cell(seconds: Array) -> str:
    return " / ".join(f"{1e6 * value:.0f}" for value in np.percentile(seconds, (50, 99, 100))) if len(seconds) else ""


def draw(results: list[Result]) -> None:
    """The share of ticks with more jitter than so much; ticks left out show as jitter of whole periods."""
    figure, axes = plt.subplots(figsize=(9, 5), layout="constrained")
    for r in results:
        jitter = np.sort(r.jitter) * 1e3
        style = "-" if r.case.realtime else ":"
        axes.step(np.maximum(jitter, 1e-3), 1.0 - np.arange(len(jitter)) / len(jitter), style, label=str(r.case))
    axes.axvline(1.0, color="grey", linewidth=0.8)
    axes.axhline(0.01, color="grey", linewidth=0.8)
    axes.set(xscale="log", yscale="log", xlabel="jitter, ms", ylabel="share of ticks with more jitter")
    axes.set_title("The control loop beside a planner")
    figure.legend(fontsize="small", loc="outside lower center", ncols=2)
    figure.savefig(PLOT, dpi=120)
    print(f"plotted into {PLOT}")  # noqa: T201


if __name__ == "__main__":
    main()
