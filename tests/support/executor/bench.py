"""The executor's state machine on a bench: an arm that may misbehave, and a clock that only the test advances."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from support.arrivals import arrival
from support.trajectories import HOME, RATE_LIMITS, ROBOT, moved, rest_to_rest
from zarm_contract.descriptor import RobotDescriptor
from zarm_contract.errors import Unavailable
from zarm_contract.messages import GoalState
from zarm_executor.goal import Chunk, Goal
from zarm_executor.guard import Guard
from zarm_executor.machine import Machine
from zarm_executor.monitor import Monitor
from zarm_executor.strategies.base import Measured, Progress, Steerable
from zarm_trajectory.arrays import Array
from zarm_trajectory.blending import blended
from zarm_trajectory.follower import TICK, Follower
from zarm_trajectory.limits import Limits
from zarm_trajectory.path_state import PathState
from zarm_trajectory.trajectory import TimedTrajectory

LIMIT = np.array(ROBOT.descriptor.cspace.acceleration)
LIMITS = Limits.of(ROBOT)
EXECUTION = ROBOT.descriptor.execution

Disturbance = Callable[[Measured], Measured | None]


class Arm(Steerable):
    """Follows the command exactly, until `disturb` changes what is measured."""

    name = "arm"

    def __init__(self) -> None:
        self.calls: list[str] = []
        self.follower = Follower(TimedTrajectory.standing(HOME), RATE_LIMITS)
        self.exact = Measured(HOME, np.zeros(6), 0.0)
        self.disturb: Disturbance = lambda measured: measured
        self.played = 1.0
        self.allowed = 1.0  # share of the speed that the robot's own controls allow
        self.failure: Unavailable | None = None
        self.deaf = False
        self.is_open = False

    def open(self) -> None:
        self.calls.append("open")
        if self.failure is not None:
            raise self.failure
        self.is_open = True

    def close(self) -> None:
        self.calls.append("close")
        self.is_open = False

    def admit(self) -> None:
        pass

    def start(self, path: TimedTrajectory, speed: float) -> None:
        self.follower = Follower(path, RATE_LIMITS, speed=speed, target=speed)

    def stop(self) -> None:
        self.calls.append("stop")
        if not self.deaf:
            self.follower.target = 0.0

    def move(self, speed: float) -> None:
        self.follower.target = speed

    def commanded(self) -> float:
        return self.follower.time

    def steer(self, path: TimedTrajectory) -> None:
        self.follower.join(path)

    def tick(self, now: float, dt: float) -> None:
        if self.follower.settled:
            self.exact = Measured(self.exact.position, np.zeros(6), now)
        else:
            self.follower.advance(dt * self.played)
            self.exact = Measured(self.follower.position, self.follower.velocity, now)

    def pace(self) -> float:
        return self.allowed

    def joint_state(self) -> Measured | None:
        return self.disturb(self.exact)

    def braking_from(self) -> PathState:
        return self.follower.state

    def progress(self) -> Progress:
        return Progress(self.follower.time, self.follower.speed, self.follower.position, self.follower.finished)


@dataclass
class Bench:
    """A machine with an arm, and a clock that only tests advance."""

    arm: Arm = field(default_factory=Arm)
    now: float = 100.0
    robot: RobotDescriptor = ROBOT.descriptor

    def __post_init__(self) -> None:
        self.machine = Machine(self.arm, TICK, Guard(self.robot))
        self.positions: list[Array] = []
        self.machine.tick(self.now)

    def tick(self, dt: float = TICK) -> None:
        self.now += dt
        self.machine.tick(self.now)
        self.positions.append(self.arm.exact.position)

    def run(self, seconds: float) -> None:
        for _ in range(round(seconds / TICK)):
            self.tick()

    def until(self, mode: str, patience: float = 20.0) -> None:
        for _ in range(round(patience / TICK)):
            if self.machine.state().mode == mode:
                return
            self.tick()
        raise AssertionError(f"{self.machine.state()} does not become {mode}")

    def execute(self, goal_id: str = "goal-1", asked: int | None = None, scene: str | None = None) -> TimedTrajectory:
        """Start a motion requested at the arrival `asked` (default: just now)."""
        path = TimedTrajectory.of(rest_to_rest(moved(1.0, -0.5), self.arm.exact.position), ROBOT.descriptor.joints)
        goal = Goal(goal_id, None, path, Monitor(path, self.robot), scene)
        self.machine.start(goal, arrival() if asked is None else asked)
        return path

    def stream(
        self, chunk: TimedTrajectory, *, last: bool = False, deadline: float = 0.1, scene: str | None = None
    ) -> None:
        """Begin the stream `stream-1` with a chunk that starts where the arm is."""
        path = blended(TimedTrajectory.standing(self.arm.exact.position), 0.0, chunk, 0.0, LIMITS)
        monitor = Monitor(path, ROBOT.descriptor)
        first = Chunk(1, 0.0, path, self.now, deadline, last, scene)
        self.machine.start(Goal("stream-1", None, path, monitor, scene, chunk=first), arrival())

    def steer(
        self, sequence: int, start: float, chunk: TimedTrajectory, *, last: bool = False, deadline: float = 0.1
    ) -> None:
        """Send a later chunk."""
        self.machine.steer("stream-1", Chunk(sequence, start, chunk, self.now, deadline, last), LIMITS)

    def statuses(self) -> list[str]:
        return [change.status for change in self.machine.changes]

    def last(self) -> GoalState:
        return self.machine.changes[-1]

    def greatest_acceleration(self) -> float:
        """Over all ticks so far, as a share of the limit."""
        return float(np.max(np.abs(np.diff(self.positions, 2, axis=0)) / TICK**2 / LIMIT))
