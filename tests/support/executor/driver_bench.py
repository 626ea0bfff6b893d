"""Every strategy on a bench: the real state machine, link and simulated arm, wired without a bus, on the test's clock."""

from __future__ import annotations

import dataclasses
import time
from collections import deque
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path as Folder
from typing import Any

import numpy as np

from support.arrivals import arrival
from support.executor.waves import chunk
from support.harness import eventually
from support.trajectories import HOME, KEYS, ROBOT, moved, rest_to_rest
from zarm_contract.descriptor import StrategyParams
from zarm_contract.key import Published
from zarm_contract.messages import DriverCommand, DriverProgress, GoalState, JointState, Trajectory
from zarm_contract.robot import RobotDescription
from zarm_executor.goal import Chunk, Goal
from zarm_executor.guard import Guard
from zarm_executor.machine import Machine
from zarm_executor.monitor import Monitor
from zarm_executor.strategies import build_strategies
from zarm_runtime.expiry import Expiry
from zarm_simulated_driver.player import CEILING, STEP, Player
from zarm_trajectory.arrays import Array
from zarm_trajectory.blending import blended
from zarm_trajectory.limits import Limits
from zarm_trajectory.trajectory import TimedTrajectory
from zarm_trajectory.turns import whole_turns

JOINTS = ROBOT.descriptor.joints
TOLD = tuple(JOINTS[index] for index in (0, 1, 3, 4, 2, 5))
LATENCY = 0.01
"""Delay (s) of a message on the bench."""
START = 1e6
"""Start of a bench's clock (s), far ahead of the machine's, so that nothing on it can be old."""


def robot_with(*, control_rate: float = 100.0, **params: Any) -> RobotDescription:
    """The robot of the tests with other strategy_params, or another rate (Hz) of the control loop."""
    assert ROBOT.descriptor.strategy_params is not None
    merged = ROBOT.descriptor.strategy_params.model_dump(exclude_none=True) | params
    execution = ROBOT.descriptor.execution.model_copy(update={"control_rate": control_rate})
    descriptor = ROBOT.descriptor.model_copy(
        update={"strategy_params": StrategyParams.model_validate(merged), "execution": execution}
    )
    return dataclasses.replace(ROBOT, descriptor=descriptor)


@dataclasses.dataclass(frozen=True)
class Case:
    """One strategy with one kind of driver."""

    strategy: str
    plays: str = "velocity"
    params: tuple[tuple[str, Any], ...] = ()

    def __str__(self) -> str:
        return "-".join((self.strategy, self.plays, *(f"{name}={value}" for name, value in self.params)))


EVERY = (("strategies", ("joint_speed", "joint_pose", "joint_trajectory")),)
MOVING = (
    Case("emulator"),
    Case("joint_speed"),
    Case("joint_pose", "position", EVERY),
    Case("joint_trajectory"),
    Case("joint_trajectory", "position", (("state_topic", None),)),
    Case("joint_trajectory", "velocity", (("state_topic", None),)),
    Case("joint_trajectory", "velocity", (("stop", "empty"),)),
)


class Wire:
    """Stands in for a bus: publications arrive at the arm, and the arm's reports at the executor, one step later."""

    def __init__(self, bench: DriverBench) -> None:
        self.bench = bench

    def publisher(self, key: Published[DriverCommand]) -> Wire:
        assert key.realtime
        return self

    def put(self, command: DriverCommand) -> None:
        self.bench.commands.append((self.bench.now, command))

    def latest(self, key: str) -> Told:
        told = {KEYS.driver_joint_states: self.bench.joint_states, KEYS.driver_progress: self.bench.progress}
        return told.get(key, Told())


class Told:
    """The newest message of the arm and its time of arrival; progress of `lost_from` or more is lost."""

    def __init__(self) -> None:
        self.newest: tuple[JointState | DriverProgress, float] | None = None
        self.lost_from = np.inf
        self._received: Any = None

    def received(self) -> Any:
        newest = self.newest
        if newest is None or not isinstance(newest[0], DriverProgress) or newest[0].fraction < self.lost_from:
            self._received = newest
        return self._received


class DriverBench:
    """A machine with the strategy of a case, and an arm behind a driver that tests can make misbehave.

    The machine ticks at `rate` Hz; the driver reports the arm's joints at 100 Hz and plays a point every 20 ms,
    whatever the rate, initially `phase` s after the ticks. Where the driver `wraps`, the last joint is continuous and
    reported within half a turn to each side, as many drivers do.
    """

    def __init__(
        self,
        case: Case,
        folder: Folder,
        rate: float = 100.0,
        phase: float = 0.003,
        ceiling: float = CEILING,
        *,
        wraps: bool = False,
        start: Array = HOME,
    ) -> None:
        params = dict(case.params)
        self._wraps = np.array([False] * 5 + [wraps])
        self.period = 1.0 / rate
        self.case = case
        self.now = START
        self._arm_at = START + phase
        self.arm = Player(start, plays=case.plays, ceiling=ceiling)
        self.silent = False
        self.stalled = False
        self.commands: list[tuple[float, DriverCommand]] = []
        self.joint_states, self.progress = Told(), Told()
        self.positions: list[Array] = []
        self.feeds: list[Array] = []
        self.truth: list[tuple[Array, Array]] = []
        self._taken = 0
        self.stalled_at = self.stalled_until = -np.inf
        self._expiry = Expiry()
        self.late = 0
        self._reported: deque[tuple[float, JointState, DriverProgress | None]] = deque()
        self._sequence = 0
        self.robot = robot_with(control_rate=rate, **params)
        if wraps:
            lower, upper = (*self.robot.lower[:5], -np.inf), (*self.robot.upper[:5], np.inf)
            self.robot = dataclasses.replace(self.robot, lower=lower, upper=upper)
        self.registry = build_strategies(self.robot, folder, Wire(self), KEYS)  # type: ignore[arg-type]
        self._pass(2 * STEP)
        self.machine = Machine(self.registry.find(case.strategy), self.period, Guard(self.robot.descriptor))
        self.tick()

    def _pass(self, seconds: float) -> None:
        """Let time pass for the arm, which advances in steps of its own."""
        self.now += seconds
        while self._arm_at + STEP <= self.now + 1e-6:
            self._arm_at += STEP
            self._arm_step(self._arm_at)

    def _arm_step(self, now: float) -> None:
        passing = now >= self.stalled_until
        while passing and self._taken < len(self.commands) and self.commands[self._taken][0] <= now - LATENCY + 1e-6:
            command = self.commands[self._taken][1]
            assert command.joint_names == JOINTS
            if not self._expiry.in_time(command, now):
                self._taken += 1
                self.late += 1
                continue
            position = np.array(command.position).reshape(-1, 6)
            if len(position):  # in the driver's own turn, in which it reports
                position += whole_turns(self.arm.position - position[0], self._wraps)
            self.arm.play(position, np.array(command.velocity).reshape(-1, 6))
            self._sequence = command.sequence
            self._taken += 1
        self.arm.step(stalled=self.stalled)
        self.truth.append((self.arm.position, self.arm.velocity))
        self.feeds.append(self.arm.feed.copy())
        self._expiry.report(now, now)
        if not self.silent and passing:
            order = [JOINTS.index(name) for name in TOLD]
            reported = self.arm.position - whole_turns(self.arm.position, self._wraps)
            self.joint_states.newest = (
                JointState(
                    stamp=now,
                    joint_names=TOLD,
                    position=tuple(reported[order].tolist()),
                    velocity=tuple(self.arm.velocity[order].tolist()),
                ),
                now,
            )
            if self._sequence:
                self.progress.newest = DriverProgress(sequence=self._sequence, fraction=self.arm.fraction), now

    def stall(self, seconds: float) -> None:
        """Hold up all messages, both ways, for this time from now on; then the commands arrive, and the newest of the
        joints.
        """
        self.stalled_at, self.stalled_until = self.now, self.now + seconds

    def freeze(self, seconds: float) -> None:
        """Let time pass without running the machine."""
        self._pass(seconds)

    def tick(self) -> None:
        self._pass(self.period)
        measured = self.machine.tick(self.now)
        assert measured is not None
        self.positions.append(measured.position)

    def run(self, seconds: float) -> None:
        for _ in range(round(seconds / self.period)):
            self.tick()

    def until(self, mode: str, patience: float = 20.0) -> None:
        for _ in range(round(patience / self.period)):
            if self.machine.state().mode == mode:
                return
            self.tick()
        raise AssertionError(f"{self.machine.state()} does not become {mode}")

    def execute(
        self, goal: Array | None = None, start: Array = HOME, timed: Callable[[Array, Array], Trajectory] = rest_to_rest
    ) -> TimedTrajectory:
        """Start a motion along a path to `goal`."""
        trajectory = timed(moved(1.0, -0.5, 0.3) if goal is None else goal, start)
        path = TimedTrajectory.of(trajectory, JOINTS).approached_from(
            self.positions[-1], np.full(6, 1.2), np.full(6, 1.0), np.full(6, 500.0)
        )
        monitor = Monitor(path, self.robot.descriptor)
        self.machine.start(Goal("goal", None, path, monitor), arrival())
        return path

    def stream(self, seconds: float) -> float:
        """Stream a swinging target, a chunk every 0.05 s; returns the time of the stream."""
        limits, start = Limits.of(self.robot), self.now
        for index in range(round(seconds / 0.05)):
            at = self.now - start
            piece = Chunk(index + 1, at, chunk(at), self.now, 0.1, False)
            if index == 0:
                path = blended(TimedTrajectory.standing(self.positions[-1]), 0.0, piece.trajectory, 0.0, limits)
                goal = Goal("stream", None, path, Monitor(path, self.robot.descriptor), chunk=piece)
                self.machine.start(goal, arrival())
            else:
                self.machine.steer("stream", piece, limits)
            self.run(0.05)
        return self.now - start

    def switch(self, name: str) -> None:
        """Switch to another strategy while time passes; raises what the switch raises."""
        with ThreadPoolExecutor(1) as pool:
            switched = pool.submit(self.machine.switch, self.registry.find(name), 10.0, arrival())
            eventually(
                lambda: switched.done() or self.machine.state().mode not in ("running", "paused"), "it is told to stop"
            )
            while not switched.done():
                self.tick()
                time.sleep(0)
            switched.result()

    def last(self) -> GoalState:
        return self.machine.changes[-1]

    def statuses(self) -> list[str]:
        return [change.status for change in self.machine.changes]

    def commanded_acceleration(self) -> float:
        """The greatest change of the commanded velocity, rad/s^2; for the emulated arm, of its velocity."""
        if self.case.strategy == "emulator":
            return float(np.max(np.abs(np.diff(self.positions, 2, axis=0)))) / self.period**2
        return float(np.max(np.abs(np.diff(self.feeds[::2], axis=0)))) / (2 * STEP)

    def acceleration(self) -> float:
        """The greatest change of the arm's true velocity, rad/s^2, over five points of a command."""
        velocity = np.array([velocity for _, velocity in self.truth])
        return float(np.abs(velocity[10:] - velocity[:-10]).max()) / (10 * STEP)

    def rests(self, seconds: float = 1.0) -> bool:
        """Whether nothing moves any more once the drives have settled."""
        self.run(0.5)
        where = self.positions[-1]
        self.run(seconds)
        return bool(np.allclose(self.positions[-1], where, atol=1e-5))


def distance_from(path: TimedTrajectory, position: Array) -> float:
    """How far (rad, the worst joint) a position is from a path."""
    return float(np.abs(path.sample(np.linspace(0.0, path.duration, 5000))[0] - position).max(axis=1).min())
