"""The executor process: wires state machine, control loop, reporter and ghost to the bus."""

from __future__ import annotations

import ctypes
import gc
import logging
import os
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress

from zarm_contract.messages import (
    Authority,
    CancelRequest,
    ExecuteRequest,
    GoalState,
    JointState,
    Nothing,
    Plan,
    ReplaceTrajectory,
    SceneEdited,
    Speed,
    SpeedRequest,
    Strategies,
    StrategyRequest,
    StreamChunk,
)
from zarm_contract.robot import RobotDescription
from zarm_executor.admission import REST_PATIENCE, Admission
from zarm_executor.clocks import time_of_day
from zarm_executor.executor import Executor
from zarm_executor.flight_recorder import FlightRecorder
from zarm_executor.ghost import PERIOD as GHOST_PERIOD
from zarm_executor.ghost import Ghost
from zarm_executor.guard import Guard
from zarm_executor.loop import LATE, Loop
from zarm_executor.machine import Machine
from zarm_executor.plans import Plans
from zarm_executor.reporter import PERIOD as REPORTER_PERIOD
from zarm_executor.reporter import Reporter
from zarm_executor.ring import Ring
from zarm_executor.scene import PresentScene
from zarm_executor.strategies import build_strategies
from zarm_executor.strategies.base import Strategy
from zarm_executor.streams import Streams
from zarm_executor.watchdog import Watchdog
from zarm_runtime.bus import Bus, Publisher
from zarm_runtime.metrics import Metrics
from zarm_runtime.realtime import PROCESS_PRIORITY, ask_for_realtime
from zarm_runtime.service import Service, run_service, service_parser
from zarm_runtime.state_file import StateFile, owned

log = logging.getLogger(__name__)

COMMAND_BACKLOG = 1024
"""How many commands may wait on one key: a stop is never answered `busy` because others shout as well."""

PLANNER_PATIENCE = 0.5
"""Longest wait, s, for the planner to tell its newest plan or the revision of its scene."""

DRIVER_PATIENCE = 10.0
"""Longest wait, s, at the start for the driver of the robot to tell the robot's joints."""

JOINT_STATES_PERIOD = 0.008
"""Shortest time, s, between two publications of the joints, 125 Hz: the faster ones of a driver are on its own key."""

SWITCH_INTERVAL = 0.0001
"""Longest time, s, that a thread reading a message keeps the interpreter from the control loop (Python's own: 0.005)."""

LARGE = 32 * 1024
"""Bytes: half of a batch of Zenoh (64 KiB), the pieces in which a large message comes."""
_M_MMAP_THRESHOLD = -3


class Control:
    """One period of control: moves the robot on and publishes where it is, `JOINT_STATES_PERIOD` apart at least."""

    def __init__(self, machine: Machine, joints: tuple[str, ...], publisher: Publisher[JointState]) -> None:
        self._machine = machine
        self._joints = joints
        self._publisher = publisher
        self._published = 0.0
        self._published_at = -JOINT_STATES_PERIOD

    def tick(self, now: float) -> None:
        """`now` is on the monotonic clock."""
        measured = self._machine.tick(now)
        due = now - self._published_at > 0.9 * JOINT_STATES_PERIOD
        if due and measured is not None and measured.time != self._published:
            self._published, self._published_at = measured.time, now
            stamp = measured.stamp
            self._publisher.put(
                JointState(
                    stamp=time_of_day(measured.time) if stamp is None else stamp,
                    joint_names=self._joints,
                    position=tuple(measured.position.tolist()),
                    velocity=tuple(measured.velocity.tolist()),
                )
            )


@contextmanager
def start(service: Service) -> Iterator[None]:
    """The executor, from its first tick until the robot rests after the last."""
    sys.setswitchinterval(SWITCH_INTERVAL)
    _give_back_large_blocks()
    robot, keys, bus = service.robot, service.keys, service.bus
    joints = robot.descriptor.joints
    ring = Ring(keys)
    bus.observe(ring.observe)
    period = robot.descriptor.execution.control_period
    # What a slow reader of the other keys holds up must not hold up the robot: a session of its own.
    with (
        owned(service.options.state / keys.robot, service.name) as folder,
        FlightRecorder(folder / "records", keys, ring) as records,
        service.open_bus() as command_bus,
    ):
        command_bus.observe(ring.observe)
        strategies = build_strategies(robot, folder, command_bus, keys)
        first = strategies.find(service.options.strategy or robot.descriptor.strategy)
        _wait_for(first, service)
        kept_speed = StateFile(folder / "speed.json", Speed)
        machine = Machine(first, period, Guard(robot.descriptor), speed_scale=_first_speed(robot, kept_speed))
        bus.urgent = machine.moves
        try:
            control = Control(machine, joints, command_bus.publisher(keys.joint_states, JointState, realtime=True))
            loop = Loop("control", period, control.tick, realtime=True)
            reporter = Reporter(
                bus,
                keys,
                joints,
                machine,
                StateFile(folder / "running_goal.json", GoalState),
                loop.latest,
                records.fault,
                service.metrics,
            )
            reporter.report_interrupted()
            reporter.publish()
            plans = Plans(robot.hash, lambda: bus.call(keys.plans, Nothing(), Plan, timeout=PLANNER_PATIENCE))
            present = PresentScene(
                machine, lambda: bus.call(keys.scene_revision, Nothing(), SceneEdited, timeout=PLANNER_PATIENCE)
            )
            ghost = Ghost(bus, keys, robot)
            told = bus.publisher(keys.strategy, Strategies), bus.publisher(keys.speed, Speed)
            admission = Admission(machine, reporter, robot.descriptor.execution.joint_state_timeout)
            streams = Streams(robot, machine, reporter, admission)
            executor = Executor(robot, machine, reporter, admission, plans, present, strategies, *told, kept_speed)
            _export(service.metrics, machine, loop)
            with (
                loop,
                Watchdog(loop) as watchdog,
                Loop("ghost", GHOST_PERIOD, ghost.play),
                Loop("reporter", REPORTER_PERIOD, reporter.look),
            ):
                bus.watch(keys.scene_revision, SceneEdited, present.hear)
                command_bus.subscribe(
                    keys.authority, Authority, lambda _, authority: machine.hear(authority, time.monotonic())
                )

                def receive(key: str, plan: Plan) -> None:
                    plans.add(key, plan)
                    ghost.show(key, plan)

                bus.watch(keys.plans, Plan, receive)
                service.interruptible, service.ailment = executor.check_idle, watchdog.ailment
                _serve(bus, service, executor)
                bus.subscribe_in_order(keys.stream, StreamChunk, streams.receive)
                _exempt_from_collection()
                service.ready()
                try:
                    yield
                finally:
                    if not machine.end(REST_PATIENCE):
                        log.error("the robot did not come to rest seconds=%g", REST_PATIENCE)
                    reporter.publish()
        finally:
            machine.release()


def _first_speed(robot: RobotDescription, kept: StateFile[Speed]) -> float:
    """The share of the planned speed to begin with: the descriptor's, or what a client of an earlier process set, if less."""
    speed = kept.load()
    planned = robot.descriptor.execution.speed_scale
    return planned if speed is None else min(speed.speed_scale, planned)


def _export(metrics: Metrics, machine: Machine, loop: Loop) -> None:
    """Have read what the control loop knows, when somebody does: it itself waits for nobody."""

    def age() -> float | None:
        measured = machine.joint_state()
        return None if measured is None else time.monotonic() - measured.time

    metrics.read(
        "counter",
        "zarm_ticks_missed",
        "Missed ticks of the control loop.",
        lambda: machine.state().missed_ticks,
    )
    metrics.read("gauge", "zarm_joint_state_age_seconds", "Age of the measured joint state.", age)
    metrics.read_histogram(
        "zarm_tick_lateness_seconds", "How late the ticks of the control loop began.", LATE, loop.lateness
    )


def _give_back_large_blocks() -> None:
    """Have a freed block of `LARGE` bytes or more go back to the system, where the C library is glibc.

    By itself glibc raises its bound from 128 KiB to 32 MiB by and by (mallopt(3)), and keeps what is smaller for the thread that had
    it: measured, payloads of 8 MB to all keys left 600 MiB in the process, and with this 240 MiB.
    """
    with suppress(AttributeError):  # another C library
        ctypes.CDLL(None).mallopt(_M_MMAP_THRESHOLD, LARGE)


def _exempt_from_collection() -> None:
    """Have the garbage collector pass over everything that lives as long as the process, which is nearly all there is.

    It holds up every thread while it looks: measured, 21 ms before this and 0.3 ms at most after it. It goes on to free what
    comes later, so that memory stays flat.
    """
    gc.collect()
    gc.freeze()


def _wait_for(strategy: Strategy, service: Service) -> None:
    """Give the robot's driver, which may be starting too, the time to tell its first joints."""
    if strategy.obstacle() is None:
        return
    service.starting("waiting for the robot's driver")
    deadline = time.monotonic() + DRIVER_PATIENCE
    while strategy.obstacle() is not None and time.monotonic() < deadline:
        time.sleep(0.05)


def _serve(bus: Bus, service: Service, executor: Executor) -> None:
    keys = service.keys
    bus.serve_in_order(keys.execute, ExecuteRequest, executor.execute)
    bus.serve_in_order(keys.strategy, StrategyRequest, executor.strategy, readable=True)
    bus.serve(keys.replace, ReplaceTrajectory, executor.replace, workers=1)
    bus.serve(keys.speed, SpeedRequest, executor.speed, readable=True)
    executor.publish_strategies()
    executor.publish_speed()
    bus.serve_in_order(keys.cancel, CancelRequest, executor.cancel, backlog=COMMAND_BACKLOG, overtaken=False)
    for key, command, overtaken in (
        (keys.stop, executor.stop, False),
        (keys.pause, executor.pause, False),
        (keys.resume, executor.resume, True),
        (keys.reset, executor.reset, True),
    ):
        bus.serve_in_order(key, Nothing, command, backlog=COMMAND_BACKLOG, overtaken=overtaken)


def main() -> int:
    """Run the executor of one robot until SIGTERM or SIGINT; the exit code."""
    parser = service_parser("executor")
    strategy = os.environ.get("ZARM_STRATEGY")
    parser.add_argument(
        "--strategy", default=strategy, help="the control strategy at the start (default: as in the descriptor)"
    )
    # A thread that is put aside while it holds the interpreter holds up the control loop, whatever the priority of that.
    ask_for_realtime(PROCESS_PRIORITY)
    return run_service("executor", parser, start)


if __name__ == "__main__":
    sys.exit(main())
