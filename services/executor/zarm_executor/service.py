"""The executor process: wires state machine, control loop, reporter and ghost to the bus."""

from __future__ import annotations

import ctypes
import gc
import logging
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import replace

from zarm_contract.messages import (
    GoalState,
    JointState,
    Plan,
    Speed,
)
from zarm_contract.robot import RobotDescription
from zarm_executor.admission import REST_PATIENCE, Admission
from zarm_executor.executor import Executor
from zarm_executor.flight_recorder import FlightRecorder
from zarm_executor.ghost import PERIOD as GHOST_PERIOD
from zarm_executor.ghost import Ghost
from zarm_executor.grippers import PERIOD as GRIPPERS_PERIOD
from zarm_executor.grippers import Grippers
from zarm_executor.guard import Guard
from zarm_executor.loop import LATE, Loop
from zarm_executor.machine import Machine
from zarm_executor.outputs import Outputs
from zarm_executor.plans import Plans
from zarm_executor.reporter import PERIOD as REPORTER_PERIOD
from zarm_executor.reporter import Reporter
from zarm_executor.ring import Ring
from zarm_executor.scene import PresentScene
from zarm_executor.strategies import build_strategies
from zarm_executor.strategies.base import Strategy
from zarm_executor.streams import Streams
from zarm_executor.watchdog import Watchdog
from zarm_runtime import clock
from zarm_runtime.bus import Bus, Publisher
from zarm_runtime.metrics import Metrics
from zarm_runtime.realtime import PROCESS_PRIORITY, ask_for_realtime
from zarm_runtime.service import Service, run_service, service_parser
from zarm_runtime.state_file import StateFile, owned

log = logging.getLogger(__name__)

COMMAND_BACKLOG = 1024
"""Number of commands that may wait on one key: other traffic must never cause a stop to be answered with `busy`."""

PLANNER_PATIENCE = 0.5
"""Longest wait (s) for the planner to report its newest plan or its scene revision."""

DRIVER_PATIENCE = 10.0
"""Longest wait (s) at startup for the robot's driver to report its joints."""

JOINT_STATES_PERIOD = 0.008
"""Least interval (s) between two publications of the joints, 125 Hz: faster ones of a driver are on its own key."""

SWITCH_INTERVAL = 0.0001
"""Longest time (s) for which a thread reading a message may hold the interpreter while the control loop waits (Python's
default: 0.005).
"""

LARGE = 32 * 1024
"""Bytes: half of a Zenoh batch (64 KiB), the fragment size of a large message."""
_M_MMAP_THRESHOLD = -3


class Control:
    """One control period: moves the robot and publishes its joints, at least `JOINT_STATES_PERIOD` apart."""

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
                    stamp=clock.unix_time_of(measured.time) if stamp is None else stamp,
                    joint_names=self._joints,
                    position=tuple(measured.position.tolist()),
                    velocity=tuple(measured.velocity.tolist()),
                    effort=None if measured.effort is None else tuple(measured.effort.tolist()),
                )
            )


@contextmanager
def start(service: Service) -> Iterator[None]:
    """The executor, from its first tick until the robot has come to rest after the last."""
    sys.setswitchinterval(SWITCH_INTERVAL)
    _give_back_large_blocks()
    robot, keys, bus = _with_real_timeouts(service.robot), service.keys, service.bus
    joints = robot.descriptor.joints
    ring = Ring(keys)
    bus.observe(ring.observe)
    period = robot.descriptor.execution.control_period
    # A slow reader of the other keys must not hold up the robot, so it has a session of its own.
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
            control = Control(machine, joints, command_bus.publisher(keys.joint_states))
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
            plans = Plans(robot.hash, lambda: bus.read(keys.plans, timeout=PLANNER_PATIENCE))
            present = PresentScene(machine, lambda: bus.read(keys.scene_revision, timeout=PLANNER_PATIENCE))
            ghost = Ghost(bus, keys, robot)
            settings = bus.publisher(keys.strategy), bus.publisher(keys.speed)
            admission = Admission(machine, reporter, robot.descriptor.execution.joint_state_timeout)
            streams = Streams(robot, machine, reporter, admission)
            grippers = Grippers(
                robot, machine, command_bus, keys, StateFile(folder / "emulated_grippers.json", JointState)
            )
            outputs = Outputs(robot, machine.state().strategy, command_bus, keys)
            executor = Executor(
                robot,
                machine,
                reporter,
                admission,
                plans,
                present,
                strategies,
                *settings,
                kept_speed,
                grippers,
                outputs,
            )
            _export(service.metrics, machine, loop)
            with (
                loop,
                Watchdog(loop) as watchdog,
                Loop("ghost", GHOST_PERIOD, ghost.play),
                Loop("reporter", REPORTER_PERIOD, reporter.look),
                Loop("grippers", GRIPPERS_PERIOD, grippers.tick) if grippers else nullcontext(),
            ):
                bus.watch(keys.scene_revision, present.receive)
                command_bus.subscribe(
                    keys.authority, lambda _, authority: machine.receive(authority, clock.monotonic())
                )
                command_bus.subscribe(keys.external_torque, lambda _, felt: machine.collide(felt))

                def receive(key: str, plan: Plan) -> None:
                    plans.add(key, plan)
                    ghost.show(key, plan)

                bus.watch(keys.plans, receive)
                service.interruptible, service.impairment = executor.check_idle, watchdog.impairment
                _serve(bus, service, executor)
                bus.serve_in_order(keys.gripper, grippers.move)
                bus.serve(keys.gripper_cancel, grippers.cancel)
                bus.serve(keys.output, outputs.set)
                bus.subscribe_in_order(keys.stream, streams.receive)
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
    """The initial share of the planned speed: the descriptor's, or a lower one set by a client of an earlier process."""
    speed = kept.load()
    planned = robot.descriptor.execution.speed_scale
    return planned if speed is None else min(speed.speed_scale, planned)


def _export(metrics: Metrics, machine: Machine, loop: Loop) -> None:
    """Register metrics of the control loop, read on demand: the loop itself waits for nobody."""

    def age() -> float | None:
        measured = machine.joint_state()
        return None if measured is None else clock.monotonic() - measured.time

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
    """Make glibc, if that is the C library, return freed blocks of `LARGE` bytes or more to the system.

    By default glibc gradually raises its threshold from 128 KiB to 32 MiB (mallopt(3)) and keeps smaller blocks for the
    thread that had them: measured, payloads of 8 MB to all keys left 600 MiB in the process, and with this 240 MiB.
    """
    with suppress(AttributeError):  # another C library
        ctypes.CDLL(None).mallopt(_M_MMAP_THRESHOLD, LARGE)


def _exempt_from_collection() -> None:
    """Exempt everything that lives as long as the process, nearly all there is, from garbage collection.

    The collector stops every thread while it runs: measured, 21 ms before this and 0.3 ms at most after it. It still
    frees newer objects, so memory stays flat.
    """
    gc.collect()
    gc.freeze()


def _with_real_timeouts(robot: RobotDescription) -> RobotDescription:
    """The robot, with timeouts of messages that are as long in real time as its descriptor says: other programs take as long as ever to
    speak, however fast its time passes.
    """
    execution = robot.descriptor.execution
    timeouts = {
        name: getattr(execution, name) * clock.speed
        for name in ("joint_state_timeout", "hold_timeout", "guard_timeout")
    }
    changed = robot.descriptor.model_copy(update={"execution": execution.model_copy(update=timeouts)})
    return replace(robot, descriptor=changed)


def _wait_for(strategy: Strategy, service: Service) -> None:
    """Give the robot's driver, which may be starting too, time to report its first joints."""
    if strategy.obstacle() is None:
        return
    service.starting("waiting for the robot's driver")
    deadline = clock.monotonic() + DRIVER_PATIENCE
    while strategy.obstacle() is not None and clock.monotonic() < deadline:
        service.check_running()
        clock.sleep(0.05)


def _serve(bus: Bus, service: Service, executor: Executor) -> None:
    keys = service.keys
    bus.serve_in_order(keys.execute, executor.execute)
    bus.serve_in_order(keys.strategy, executor.strategy)
    bus.serve(keys.replace, executor.replace, workers=1)
    bus.serve(keys.speed, executor.speed)
    executor.publish_strategies()
    executor.publish_speed()
    bus.serve_in_order(keys.cancel, executor.cancel, backlog=COMMAND_BACKLOG, overtaken=False)
    for key, command, overtaken in (
        (keys.stop, executor.stop, False),
        (keys.pause, executor.pause, False),
        (keys.resume, executor.resume, True),
        (keys.reset, executor.reset, True),
    ):
        bus.serve_in_order(key, command, backlog=COMMAND_BACKLOG, overtaken=overtaken)


def main() -> int:
    """Run the executor of one robot until SIGTERM or SIGINT; the exit code."""
    parser = service_parser("executor")
    strategy = os.environ.get("ZARM_STRATEGY")
    parser.add_argument(
        "--strategy", default=strategy, help="the control strategy at the start (default: as in the descriptor)"
    )
    # A thread descheduled while it holds the interpreter holds up the control loop, whatever the loop's priority.
    ask_for_realtime(PROCESS_PRIORITY)
    return run_service("executor", parser, start)


if __name__ == "__main__":
    sys.exit(main())
