"""Two machines and the wire between them: `python tests/benchmarks/hosts.py [seconds of each measurement]`.

Network namespaces as machines, a planner on one, an executor with an emulated arm on the other, a router on each. First a wire
that is as good as none, then one that is 20 ms late each way, then one that loses 5 % of all packets too: what plans, goals and
joint states take. Then the wire is cut for a while, and mended: how long until joint states are heard again, and until the
executor answers. The clients are processes of their own on the machine in question.

Needs Linux, root and iproute2.
"""

from __future__ import annotations

import argparse
import itertools
import json
import multiprocessing
import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from zarm_trajectory.arrays import Array

sys.path.insert(0, str(Path(__file__).parents[1]))
from support.harness import PATIENCE, eventually
from support.network.two_hosts import LOCAL, Host, Hosts, enter, hosts, obstacle
from support.network.wire import Quality
from support.trajectories import HOME, KEYS, moved, rest_to_rest
from zarm_contract.errors import Unavailable
from zarm_contract.messages import (
    CancelRequest,
    ExecuteRequest,
    GoalState,
    JointGoal,
    PlanRequest,
)
from zarm_runtime.bus import Bus

WIRES = {
    "as it is": Quality(),
    "20 ms late": Quality(delay=0.02),
    "20 ms late, 5 % lost": Quality(delay=0.02, loss=0.05),
}
CUTS = (0.5, 1.0, 2.0, 4.0, 8.0, 12.0)
"""How long the wire is cut, s."""
GOALS, PLANS = 5, 8
"""How many goals are executed, and plans asked for before each."""


@dataclass
class Seen:
    """What a client on one machine saw; times in s. `feedback` lies between two states of a goal, `ages` are of joint states."""

    plan: Array
    execute: Array
    cancel: Array
    feedback: Array
    ages: Array
    rate: float
    missed: int


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("seconds", nargs="?", type=float, default=4.0, help="length of each measurement")
    seconds = parser.parse_args().seconds
    if reason := obstacle():
        print(f"left out: {reason}")  # noqa: T201
        return
    with tempfile.TemporaryDirectory() as folder, hosts(Path(folder)) as pair, ExitStack() as stack:
        for host, name in ((pair.workstation, "planner"), (pair.robot, "executor")):
            stack.enter_context(host.service(name)).wait_ready(pair.workstation.bus, KEYS)
        table = Table(
            "wire",
            "asked on",
            "plan",
            "execute",
            "cancel",
            "between states of a goal",
            "joint state's age",
            "a second",
            "missed ticks",
            title="ms, p50 / p99 / max",
        )
        for name, quality in WIRES.items():
            pair.wire.become(quality)
            for host, where in ((pair.workstation, "workstation"), (pair.robot, "robot")):
                seen: Seen = on(host, client, seconds)
                columns = (seen.plan, seen.execute, seen.cancel, seen.feedback, seen.ages)
                table.add_row(name, where, *map(cell, columns), f"{seen.rate:.0f}", str(seen.missed))
        back = Table("cut for", "joint states again after", "an answer after", title="s")
        pair.wire.become(WIRES["as it is"])
        for cut in CUTS:
            heard, answered = reconnected(pair, cut)
            back.add_row(f"{cut:g}", f"{heard:.2f}", f"{answered:.2f}")
    console = Console(width=180)
    console.print(table)
    console.print(back)


def on(host: Host, work: Callable[..., object], *arguments: object) -> object:
    """What `work` finds, as a process on a host."""
    here, there = multiprocessing.Pipe()
    process = multiprocessing.get_context("spawn").Process(
        target=update_object, args=(there, host.namespace, work, *arguments)
    )
    process.start()
    found = here.recv()
    process.join()
    return found


def update_object(pipe: Connection, namespace: str, work: Callable[..., object], *arguments: object) -> None:
    """Run in that process."""
    enter(namespace)
    pipe.send(work(*arguments))


def client(seconds: float) -> Seen:
    """Plan, execute and listen, through the router of this host."""
    joints: list[tuple[float, bytes]] = []
    states: list[tuple[float, GoalState]] = []
    planned, executed, cancelled = [], [], []
    request = PlanRequest(goal=JointGoal(kind="joints", position=tuple(moved(1.0))), start=tuple(HOME))
    with Bus(LOCAL) as bus:
        bus.listen(KEYS.joint_states, lambda _, payload: joints.append((time.time(), payload)))
        bus.subscribe(KEYS.goal("*"), lambda _, goal: states.append((time.monotonic(), goal)))
        eventually(lambda: joints, "joints are told")
        began, before = time.monotonic(), bus.read(KEYS.executor_state, timeout=PATIENCE)
        for _ in range(GOALS):
            planned += [timed(lambda: bus.call(KEYS.plan, request, timeout=PATIENCE)) for _ in range(PLANS)]
            where = np.array(json.loads(joints[-1][1])["position"])
            target = HOME if np.max(np.abs(where - HOME)) > 0.5 else moved(1.0, -0.5, 0.3)
            motion = ExecuteRequest(trajectory=rest_to_rest(target, where, slower=2.0))
            executed.append(timed(lambda motion=motion: bus.call(KEYS.execute, motion, timeout=PATIENCE)))
            time.sleep(seconds / GOALS)
            cancelled.append(timed(lambda: bus.call(KEYS.cancel, CancelRequest(), timeout=PATIENCE)))
            eventually(lambda: states[-1][1].done, "the goal has ended")
            time.sleep(0.2)  # until the joints at rest have come
        took = time.monotonic() - began
        after = bus.read(KEYS.executor_state, timeout=PATIENCE)
    running = [
        (later - at)
        for (at, one), (later, other) in itertools.pairwise(states)
        if one.status == other.status == "running"
    ]
    return Seen(
        np.array(planned),
        np.array(executed),
        np.array(cancelled),
        np.array(running),
        np.array([at - json.loads(payload)["stamp"] for at, payload in joints]),
        len(joints) / took,
        after.missed_ticks - before.missed_ticks,
    )


def timed(work: Callable[[], object]) -> float:
    """How long it took, s."""
    began = time.monotonic()
    work()
    return time.monotonic() - began


def reconnected(pair: Hosts, cut: float) -> tuple[float, float]:
    """Cut the wire for so long; how long after that the workstation heard joint states, and had an answer."""
    heard: list[float] = []
    bus = pair.workstation.bus
    bus.listen(KEYS.joint_states, lambda *_: heard.append(time.monotonic()))
    eventually(lambda: heard, "joint states are heard")
    pair.wire.become(Quality(cut=True))
    time.sleep(cut)
    mended = time.monotonic()
    pair.wire.become(WIRES["as it is"])
    eventually(lambda: heard[-1] > mended, "joint states are heard again")
    first = next(at for at in heard if at > mended)

    def answer() -> bool:
        with suppress(Unavailable):
            return bool(bus.read(KEYS.executor_state, timeout=0.2))
        return False

    eventually(answer, "the executor answers")
    return first - mended, time.monotonic() - mended


def cell(seconds: Array) -> str:
    return " / ".join(f"{1e3 * value:.1f}" for value in np.percentile(seconds, (50, 99, 100))) if len(seconds) else ""


if __name__ == "__main__":
    main()
