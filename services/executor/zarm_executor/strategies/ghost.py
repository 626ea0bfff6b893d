"""The strategy that never moves the robot, for planning and previews without risk."""

from __future__ import annotations

from zarm_contract.errors import Unavailable
from zarm_executor.strategies.base import Measured, Progress, Strategy
from zarm_executor.strategies.emulator import EmulatedRobot
from zarm_runtime import clock
from zarm_trajectory.path_state import PathState
from zarm_trajectory.trajectory import TimedTrajectory


class GhostOnly(Strategy):
    """Refuses every motion; only the preview plays. The robot is still measured, so that plans can start at its
    position.
    """

    name = "ghost"

    def __init__(self, robot: EmulatedRobot) -> None:
        self._robot = robot

    def open(self) -> None:
        """Nothing is held; the robot's position is known at once."""
        self._robot.rest(clock.monotonic())

    def close(self) -> None:
        """Nothing was held."""

    def admit(self) -> None:
        """Refuse: nothing moves."""
        raise Unavailable(
            "the active strategy is ghost, which moves nothing; switch to another one first, such as emulator "
            "(executor/strategy)"
        )

    def start(self, trajectory: TimedTrajectory, speed: float) -> None:
        """Refuse: nothing moves."""
        self.admit()

    def stop(self) -> None:
        """Nothing moves."""

    def move(self, speed: float) -> None:
        """Nothing moves."""

    def tick(self, now: float, dt: float) -> None:
        """The robot stays."""
        self._robot.rest(now)

    def joint_state(self) -> Measured | None:
        """The robot's position."""
        return self._robot.measured

    def braking_from(self) -> PathState:
        """It stands."""
        return PathState(0.0, 0.0)

    def progress(self) -> Progress:
        """No motion: finished from the beginning."""
        return Progress(time=0.0, speed=0.0, command=self._robot.measured.position, finished=True)
