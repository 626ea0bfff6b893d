"""The executor process: wires state machine, control loop, reporter and ghost to the bus."""

from __future__ import annotations

import logging
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager

from zarm_contract.bus import Bus, Publisher
from zarm_contract.messages import (
    CancelRequest,
    ExecuteRequest,
    GoalState,
    JointState,
    Nothing,
    Plan,
    SceneEdited,
    Strategies,
    StrategyRequest,
)
from zarm_contract.service import Service, run_service, service_parser
from zarm_executor.executor import REST_PATIENCE, Executor
from zarm_executor.follower import TICK
from zarm_executor.ghost import PERIOD as GHOST_PERIOD
from zarm_executor.ghost import Ghost
from zarm_executor.loop import Loop
from zarm_executor.machine import Machine
from zarm_executor.plans import Plans
from zarm_executor.reporter import PERIOD as REPORTER_PERIOD
from zarm_executor.reporter import Reporter
from zarm_executor.state_file import StateFile
from zarm_executor.strategies import build_strategies
from zarm_executor.strategies.base import Strategy

log = logging.getLogger(__name__)

COMMAND_BACKLOG = 1024
"""How many commands may wait on one key: a stop is never answered `busy` because others shout as well."""

PLANNER_PATIENCE = 0.5
"""Longest wait, s, for the planner to tell its newest plan or the revision of its scene."""

DRIVER_PATIENCE = 10.0
"""Longest wait, s, at the start for the driver of the robot to tell the robot's joints."""

SWITCH_INTERVAL = 0.0005
"""Longest time, s, that a thread reading a message keeps the interpreter from the control loop (Python's own: 0.005)."""


class Control:
    """One period of control: moves the robot on and publishes where it is."""

    def __init__(self, machine: Machine, joints: tuple[str, ...], publisher: Publisher[JointState]) -> None:
        self._machine = machine
        self._joints = joints
        self._publisher = publisher
        self._published = 0.0

    def tick(self, now: float) -> None:
        """`now` is on the monotonic clock."""
        measured = self._machine.tick(now)
        if measured is not None and measured.time != self._published:
            self._published = measured.time
            self._publisher.put(
                JointState(
                    stamp=time.time() - (time.monotonic() - measured.time),
                    joint_names=self._joints,
                    position=tuple(measured.position.tolist()),
                    velocity=tuple(measured.velocity.tolist()),
                )
            )


@contextmanager
def start(service: Service) -> Iterator[None]:
    """The executor, from its first tick until the robot rests after the last."""
    sys.setswitchinterval(SWITCH_INTERVAL)
    robot, keys, bus = service.robot, service.keys, service.bus
    joints, folder = robot.descriptor.joints, service.options.state / keys.robot
    # What a slow reader of the other keys holds up must not hold up the robot: a session of its own.
    with Bus(service.options.connect) as command_bus:
        strategies = build_strategies(robot, folder, command_bus, keys)
        first = strategies.find(service.options.strategy or robot.descriptor.strategy)
        _wait_for(first, service)
        machine = Machine(first)
        try:
            control = Control(machine, joints, command_bus.publisher(keys.joint_states, JointState, realtime=True))
            reporter = Reporter(bus, keys, machine, StateFile(folder / "running_goal.json", GoalState))
            reporter.report_interrupted()
            reporter.publish()
            plans = Plans(
                robot.hash,
                newest=lambda: bus.call(keys.plans, Nothing(), Plan, timeout=PLANNER_PATIENCE),
                scene=lambda: bus.call(keys.scene_revision, Nothing(), SceneEdited, timeout=PLANNER_PATIENCE),
            )
            ghost = Ghost(bus, keys, robot)
            executor = Executor(robot, machine, reporter, plans, strategies, bus.publisher(keys.strategy, Strategies))
            with (
                Loop("control", TICK, control.tick, realtime=True),
                Loop("ghost", GHOST_PERIOD, ghost.play),
                Loop("reporter", REPORTER_PERIOD, reporter.publish),
            ):
                bus.watch(keys.scene_revision, SceneEdited, plans.set_scene)
                for receive in (plans.add, ghost.show):
                    bus.watch(keys.plans, Plan, receive)
                service.interruptible = executor.check_idle
                _serve(bus, service, executor)
                service.ready()
                try:
                    yield
                finally:
                    if not machine.end(REST_PATIENCE):
                        log.error("the robot did not come to rest seconds=%g", REST_PATIENCE)
                    reporter.publish()
        finally:
            machine.release()


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
    bus.serve(keys.execute, ExecuteRequest, executor.execute)
    bus.serve(keys.strategy, StrategyRequest, executor.strategy, readable=True)
    executor.publish_strategies()
    bus.serve(keys.cancel, CancelRequest, executor.cancel, backlog=COMMAND_BACKLOG)
    for key, command in (
        (keys.stop, executor.stop),
        (keys.pause, executor.pause),
        (keys.resume, executor.resume),
        (keys.reset, executor.reset),
    ):
        bus.serve(key, Nothing, command, backlog=COMMAND_BACKLOG)


def main() -> int:
    """Run the executor of one robot until SIGTERM or SIGINT; the exit code."""
    parser = service_parser("executor")
    parser.add_argument("--strategy", help="control strategy at the start (default: the descriptor's)")
    return run_service("executor", parser, start)


if __name__ == "__main__":
    sys.exit(main())
