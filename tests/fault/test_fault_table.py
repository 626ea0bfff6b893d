"""Every fault comes to what the table in README.md promises of it; `ordeal.py` holds what is checked, the same for all."""

from __future__ import annotations

import itertools
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass

import numpy as np
import pytest

from support.executor.driven import FAR
from support.faults.arena import STEP, Arena, arena
from support.faults.impostor import impostor
from support.faults.ordeal import Fault, Promise, endure
from support.faults.wall_clock import STEPPABLE
from support.harness import PATIENCE, ServiceProcess, eventually
from support.trajectories import HOME, ROBOT, rest_to_rest
from zarm_contract.messages import DriverFault, ExecuteRequest, JointGoal, JointState, PlanRequest
from zarm_executor.machine import STALL_LIMIT
from zarm_runtime.bus import Bus
from zarm_simulated_driver.player import CEILING
from zarm_trajectory.follower import CATCH_UP

pytestmark = pytest.mark.timed

STREAMED, WHOLE = "joint_speed", "joint_trajectory"

EXECUTION, CSPACE, PARAMS = ROBOT.descriptor.execution, ROBOT.descriptor.cspace, ROBOT.descriptor.strategy_params
assert PARAMS is not None
LATE = CATCH_UP + PARAMS.point_dt
"""What may come on top of every bound: late ticks that are caught up with, and the point that is being played."""
LAG = 0.15
"""The drives follow with a lag of 0.03 s: from 0.2 rad/s to rest in five times that."""
BRAKE = LATE + LAG + max(CSPACE.velocity) / min(CSPACE.acceleration) + max(CSPACE.acceleration) / min(CSPACE.jerk)
OWN_BRAKE = LATE + LAG + max(CSPACE.velocity) / CEILING
REST_OF_MOTION = LATE + LAG + rest_to_rest(FAR, HOME).duration + EXECUTION.settle_time

STALE = EXECUTION.joint_state_timeout + BRAKE, "joint_state_timeout, then v/a + a/j of the executor"
RUN_OUT = PARAMS.chunk_period + PARAMS.look_ahead + BRAKE, "the last chunk, which brakes with v/a + a/j of the executor"
AT_ONCE = OWN_BRAKE, "v/a of the driver"
LEFT_PATH = BRAKE, "v/a + a/j of the executor, from path_tolerance on"
LAGS = 0.5 + BRAKE, "half a second until it shows, then v/a + a/j of the executor"
GOES_ON = REST_OF_MOTION, "the motion goes on to its end"
HELD = BRAKE + 0.8 + REST_OF_MOTION, "0.8 s, v/a + a/j of the executor, and the motion goes on to its end"
PLAYS_ON = REST_OF_MOTION, "the driver plays what it has to the end"

MUTE = DriverFault(silent=True)
SOUND = DriverFault()


def wait_for(place: Arena, since: int, seconds: float) -> None:
    """Wait until so long has passed for the arm since its step `since`."""
    eventually(lambda: (place.samples() - since) * STEP >= seconds, f"{seconds:g} s have passed")


def wait_until_given_up(place: Arena, struck: int) -> None:
    """Wait until the executor, which may not be heard, holds the motion no longer for joints that do not come."""
    wait_for(place, struck, EXECUTION.joint_state_timeout + EXECUTION.hold_timeout + 2 * LATE)


# --- faults of the executor's process, and of those beside it ---


def executor_killed(place: Arena) -> Iterator[str | None]:
    yield place.go()
    place.executor.kill()
    yield None
    place.restart_executor()


def executor_frozen(place: Arena) -> Iterator[str | None]:
    yield place.go()
    os.kill(place.executor.process.pid, signal.SIGSTOP)
    wait_for(place, place.samples(), 1.2 * STALL_LIMIT)
    yield None
    os.kill(place.executor.process.pid, signal.SIGCONT)
    place.client.mode("fault")


def planner_killed(place: Arena) -> Iterator[str | None]:
    with ServiceProcess("planner", place.endpoint, place.folder) as planner:
        planner.wait_ready(place.bus, place.keys)
        start, goal = (tuple(place.motion().position[row]) for row in (0, -1))
        request = PlanRequest(goal=JointGoal(kind="joints", position=goal), start=start)
        plan = place.bus.call(place.keys.plan, request, timeout=PATIENCE)
        yield place.client.execute(plan_id=plan.plan_id)
        planner.kill()
        yield None


CLIENT = """
import sys
from zarm_contract.keys import Keys
from zarm_contract.messages import ExecuteRequest
from zarm_runtime.bus import Bus

with Bus(sys.argv[1]) as bus:
    request = ExecuteRequest.model_validate_json(sys.stdin.readline())
    print(bus.call(Keys(sys.argv[2]).execute, request, timeout=10).goal_id, flush=True)
    sys.stdin.readline()
"""


def client_killed(place: Arena) -> Iterator[str | None]:
    command = [sys.executable, "-c", CLIENT, place.endpoint, place.keys.robot]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as client:
        assert client.stdin is not None
        assert client.stdout is not None
        client.stdin.write(ExecuteRequest(trajectory=place.motion()).model_dump_json(exclude_none=True) + "\n")
        client.stdin.flush()
        yield client.stdout.readline().strip()
        client.kill()
        yield None


def second_executor(place: Arena) -> Iterator[str | None]:
    yield place.go()
    with place.new_executor() as second:
        assert second.process.wait(PATIENCE) == 1
        assert "already on this bus" in second.output()
        yield None


# --- faults of the driver ---


def driver_silent(place: Arena) -> Iterator[str | None]:
    yield place.go()
    place.set_fault(MUTE)
    yield None
    place.client.mode("fault")
    place.set_fault(SOUND)
    place.all_heard()


def silent_for(seconds: float) -> Fault:
    def fault(place: Arena) -> Iterator[str | None]:
        yield place.go()
        place.set_fault(MUTE)
        wait_for(place, place.samples(), seconds)
        place.set_fault(SOUND)
        yield None

    return fault


def driver_stalls(place: Arena) -> Iterator[str | None]:
    yield place.go()
    place.set_fault(DriverFault(stall=True))
    yield None
    place.client.mode("fault")
    place.set_fault(SOUND)


def commands_lost(place: Arena) -> Iterator[str | None]:
    yield place.go()
    place.set_fault(DriverFault(drop=1.0))
    if place.strategy == WHOLE:  # it has everything already; what is lost is the stop
        place.client.command(place.keys.stop)
    yield None
    place.client.mode("fault")
    place.set_fault(SOUND)


def joints_jump(place: Arena) -> Iterator[str | None]:
    yield place.go()
    place.set_fault(DriverFault(jump=(0.0, 0.0, 0.0, 0.0, 0.0, 0.5)))
    yield None
    place.client.mode("fault")
    place.set_fault(DriverFault(jump=(0.0, 0.0, 0.0, 0.0, 0.0, -0.5)))


# --- joint states that are not those of the robot now ---

Telling = Callable[[np.ndarray, dict[str, object]], dict[str, object]]


def told_instead(tell: Telling) -> Fault:
    """The driver falls silent, and somebody else tells this."""

    def fault(place: Arena) -> Iterator[str | None]:
        yield place.go()
        with impostor(place, tell):
            place.set_fault(MUTE)
            yield None
            place.client.mode("fault")
        place.set_fault(SOUND)
        place.all_heard()

    return fault


def not_numbers(_: np.ndarray, true: dict[str, object]) -> dict[str, object]:
    return true | {"position": [float("nan")] * 6}


def foreign_names(_: np.ndarray, true: dict[str, object]) -> dict[str, object]:
    return true | {"joint_names": [f"other_{number}" for number in range(6)]}


def five_of_six(_: np.ndarray, true: dict[str, object]) -> dict[str, object]:
    return true | {key: true[key][:5] for key in ("joint_names", "position", "velocity")}  # type: ignore[index]


def one_stamp(_: np.ndarray, true: dict[str, object]) -> dict[str, object]:
    return true | {"stamp": 1.0}


def half_a_second_late(trace: np.ndarray, true: dict[str, object]) -> dict[str, object]:
    row = trace[-round(0.5 / STEP)]
    return true | {"position": row[:6].tolist(), "velocity": row[6:].tolist()}


def other_order(place: Arena) -> Iterator[str | None]:
    """Each of the driver's messages comes a second time, in ever another order."""
    orders = itertools.cycle(itertools.permutations(range(6)))
    usual = place.reported[-1].joint_names

    ended, lock = threading.Event(), threading.Lock()

    def turn(_: str, reported: JointState) -> None:
        if reported.joint_names == usual:
            order = next(orders)
            names, position, velocity = (
                tuple(row[index] for index in order)
                for row in (reported.joint_names, reported.position, reported.velocity)
            )
            stamp = reported.stamp + 1e-3
            with lock:
                if not ended.is_set():
                    again.put(JointState(stamp=stamp, joint_names=names, position=position, velocity=velocity))  # type: ignore[arg-type]

    yield place.go()
    with Bus(place.endpoint) as mouth, Bus(place.endpoint) as ear:
        again = mouth.publisher(place.keys.driver_joint_states)
        ear.subscribe(place.keys.driver_joint_states, turn)
        yield None
        with lock:
            ended.set()


# --- faults of the network ---


def router_restarted(place: Arena) -> Iterator[str | None]:
    yield place.go()
    place.stop_router()
    struck = place.samples()
    yield None
    wait_until_given_up(place, struck)
    place.start_router()


def link_cut(name: str) -> Fault:
    def fault(place: Arena) -> Iterator[str | None]:
        yield place.go()
        place.links[name].cut()
        struck = place.samples()
        yield None
        wait_until_given_up(place, struck)
        place.links[name].restore()
        place.all_heard()

    return fault


def link_silent(name: str) -> Fault:
    def fault(place: Arena) -> Iterator[str | None]:
        yield place.go()
        place.links[name].swallow()
        struck = place.samples()
        yield None
        wait_until_given_up(place, struck)
        place.links[name].restore()
        place.all_heard()

    return fault


def clock_stepped(name: str) -> Fault:
    def fault(place: Arena) -> Iterator[str | None]:
        reported = place.reported if name == "driver" else place.ghost()
        yield place.go()
        for hour in (3600, -3600):
            before = reported[-1].stamp
            place.clocks[name].step(hour)
            eventually(
                lambda hour=hour, before=before: (reported[-1].stamp - before) / hour > 0.9, "the clock has stepped"
            )  # type: ignore[misc]
        yield None
        place.clocks[name].step(0)

    return fault


@dataclass(frozen=True)
class Row:
    """A fault, what it comes to under each strategy, and whether it takes links and clocks that can be tampered with."""

    name: str
    fault: Fault
    promises: dict[str, Promise]
    wired: bool = False


def both(
    streamed: tuple[float, str], whole: tuple[float, str], code: str | None = None, says: str = ""
) -> dict[str, Promise]:
    return {STREAMED: Promise(*streamed, code, says), WHOLE: Promise(*whole, code, says)}


NO_JOINTS = "driver_stalled", "no new joints"
LEFT = "tolerance_violated", "path_tolerance"

ROWS = (
    Row("executor killed", executor_killed, both(RUN_OUT, PLAYS_ON, "unavailable", "the executor ended")),
    Row("executor frozen", executor_frozen, both(RUN_OUT, PLAYS_ON, "driver_stalled", "control loop stood still")),
    Row("planner killed", planner_killed, {STREAMED: Promise(*GOES_ON)}),
    Row("client killed", client_killed, both(GOES_ON, GOES_ON)),
    Row("second executor", second_executor, {STREAMED: Promise(*GOES_ON)}),
    Row("driver silent", driver_silent, both(STALE, STALE, *NO_JOINTS)),
    Row("driver silent for 0.35 s", silent_for(0.35), both(HELD, HELD)),
    Row("driver silent for 0.8 s", silent_for(0.8), both(HELD, HELD)),
    Row(
        "driver stalls",
        driver_stalls,
        {STREAMED: Promise(*AT_ONCE, *LEFT), WHOLE: Promise(*AT_ONCE, "driver_stalled", "progress_timeout")},
    ),
    Row(
        "commands lost",
        commands_lost,
        {STREAMED: Promise(*RUN_OUT, *LEFT), WHOLE: Promise(*PLAYS_ON, *LEFT)},
    ),
    Row("joints jump by 0.5 rad", joints_jump, both(LEFT_PATH, LEFT_PATH, *LEFT)),
    Row("joints are NaN", told_instead(not_numbers), both(STALE, STALE, *NO_JOINTS)),
    Row("joints of other names", told_instead(foreign_names), both(STALE, STALE, *NO_JOINTS)),
    Row("a joint is missing", told_instead(five_of_six), both(STALE, STALE, *NO_JOINTS)),
    Row("joints with one old stamp", told_instead(one_stamp), both(STALE, STALE, *NO_JOINTS)),
    Row("joints half a second late", told_instead(half_a_second_late), {STREAMED: Promise(*LAGS, *LEFT)}),
    Row("joints in another order", other_order, both(GOES_ON, GOES_ON)),
    Row("router restarted", router_restarted, both(RUN_OUT, PLAYS_ON, *NO_JOINTS)),
    Row("executor's link cut", link_cut("executor"), both(RUN_OUT, PLAYS_ON, *NO_JOINTS), wired=True),
    Row("executor's link silent", link_silent("executor"), both(RUN_OUT, PLAYS_ON, *NO_JOINTS), wired=True),
    Row("driver's link cut", link_cut("driver"), both(RUN_OUT, PLAYS_ON, *NO_JOINTS), wired=True),
    Row("driver's link silent", link_silent("driver"), both(RUN_OUT, PLAYS_ON, *NO_JOINTS), wired=True),
    Row("executor's clock stepped", clock_stepped("executor"), both(GOES_ON, GOES_ON), wired=True),
    Row("driver's clock stepped", clock_stepped("driver"), both(GOES_ON, GOES_ON), wired=True),
)


IN_MAKE_TEST = {("executor killed", STREAMED), ("driver silent", STREAMED)}
"""Of the other rows, joints that are none and a router that is away are to the executor what a silent driver is."""


class Stage:
    """One arena at a time, kept from one test to the next as long as it does."""

    def __init__(self, folders: pytest.TempPathFactory) -> None:
        self._folders = folders
        self._stack = ExitStack()
        self._kind: tuple[str, bool] | None = None
        self._place: Arena | None = None

    @contextmanager
    def set_for(self, strategy: str, *, wired: bool) -> Iterator[Arena]:
        """An arena of this kind; whoever fails in it has it to himself."""
        if self._place is None or self._kind != (strategy, wired):
            self.clear()
            self._kind = strategy, wired
            self._place = self._stack.enter_context(arena(self._folders.mktemp("arena"), strategy, wired=wired))
        try:
            yield self._place
        except BaseException:
            self.clear()
            raise

    def clear(self) -> None:
        self._place = None
        self._stack.close()


@pytest.fixture(scope="module")
def stage(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Stage]:
    stage = Stage(tmp_path_factory)
    yield stage
    stage.clear()


@pytest.mark.parametrize(
    ("strategy", "row"),
    [
        pytest.param(
            strategy,
            row,
            id=f"{row.name}-{strategy}",
            marks=() if (row.name, strategy) in IN_MAKE_TEST else pytest.mark.slow,
        )
        for wired in (False, True)
        for strategy in (STREAMED, WHOLE)
        for row in ROWS
        if row.wired == wired and strategy in row.promises
    ],
)
def test_after_a_fault_the_robot_rests_says_why_and_recovers(
    stage: Stage, note: Callable[..., None], strategy: str, row: Row
) -> None:
    if row.wired and not STEPPABLE:
        pytest.skip("the clock of a process can be stepped on Linux on x86-64 alone")
    promise = row.promises[strategy]
    with stage.set_for(strategy, wired=row.wired) as place:
        figure = endure(place, row.fault, promise)
    says = f"`{promise.code}`: {promise.says}" if promise.code else "succeeded"
    note(row.name, f"`{strategy}`", f"{promise.bound:.2f}", f"{figure.rest:.2f}", f"{figure.acceleration:.2f}", says)
