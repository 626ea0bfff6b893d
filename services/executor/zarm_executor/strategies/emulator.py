"""The emulated robot, which is always exactly where it is commanded, and the strategy that moves it."""

from __future__ import annotations

import logging

import numpy as np

from zarm_contract.descriptor import RobotDescriptor
from zarm_contract.errors import Unavailable
from zarm_contract.messages import JointState
from zarm_executor.loop import Loop
from zarm_executor.strategies.base import Measured, Progress, Steerable
from zarm_runtime import clock
from zarm_runtime.state_file import StateFile
from zarm_trajectory.arrays import Array
from zarm_trajectory.follower import Follower
from zarm_trajectory.path_state import PathState
from zarm_trajectory.rate_bounds import RateLimits
from zarm_trajectory.trajectory import TimedTrajectory

log = logging.getLogger(__name__)

SAVE_PERIOD = 0.05
"""Period (s) at which the position of a moving emulated robot is saved: the position after a crash is at most this old,
which is 0.06 rad on a joint at 1.2 rad/s.
"""


class EmulatedRobot:
    """Joints that stay where they were put, also across processes. They start at `home`."""

    def __init__(self, descriptor: RobotDescriptor, file: StateFile[JointState]) -> None:
        self._joints = descriptor.joints
        self._file = file
        self._still = np.zeros(len(self._joints))
        saved = file.load()
        if saved is not None and saved.joint_names != self._joints:
            log.warning("the saved position has other joints; the emulated robot starts at home")
            saved = None
        position = np.array(descriptor.home if saved is None else saved.position)
        self.measured = Measured(position, self._still, clock.monotonic())
        self._saved: Array | None = None

    def move(self, position: Array, velocity: Array, now: float) -> None:
        """Be at `position` with `velocity`."""
        self.measured = Measured(position, velocity, now)

    def rest(self, now: float) -> None:
        """Stay."""
        self.measured = Measured(self.measured.position, self._still, now)

    @property
    def unsaved(self) -> bool:
        """Whether the position has changed since it was saved."""
        return self.measured.position is not self._saved

    def save(self) -> None:
        """Write the position to the file. Raises Unavailable."""
        position = self.measured.position
        rest = tuple(self._still.tolist())
        self._file.save(
            JointState(
                stamp=clock.unix_time(), joint_names=self._joints, position=tuple(position.tolist()), velocity=rest
            )
        )
        self._saved = position


class Emulator(Steerable):
    """Moves the emulated robot along the path by the clock."""

    name = "emulator"

    def __init__(self, robot: EmulatedRobot, limits: RateLimits) -> None:
        self._robot = robot
        self._limits = limits
        self._follower = Follower(TimedTrajectory.standing(robot.measured.position), limits)
        self._saver = Loop("emulated robot", SAVE_PERIOD, self._save)
        self._saving_fails = False

    def open(self) -> None:
        """Begin to save the position; fails if it cannot be written."""
        self._robot.rest(clock.monotonic())  # it may not have been read for a while, but its position is known
        self._robot.save()
        self._saver.start()

    def close(self) -> None:
        """Save the position a last time."""
        self._saver.stop()
        self._save()

    def admit(self) -> None:
        """An emulated robot can always move."""

    def start(self, trajectory: TimedTrajectory, speed: float) -> None:
        """Begin at the start of `trajectory`."""
        self._follower = Follower(trajectory, self._limits, time=trajectory.begin, speed=speed, target=speed)

    def stop(self) -> None:
        """Let the path speed fall to 0."""
        self._follower.target = 0.0

    def move(self, speed: float) -> None:
        """Let the path speed become `speed`."""
        self._follower.target = speed

    def commanded(self) -> float:
        """How far the path is followed, s."""
        return self._follower.time

    def steer(self, trajectory: TimedTrajectory) -> None:
        """Go on along `trajectory`."""
        self._follower.join(trajectory)

    def tick(self, now: float, dt: float) -> None:
        """Put the robot where it should be by the clock."""
        if self._follower.settled:
            self._robot.rest(now)
        else:
            self._follower.advance(dt)
            self._robot.move(self._follower.position, self._follower.velocity, now)

    def joint_state(self) -> Measured | None:
        """Where the emulated robot is."""
        return self._robot.measured

    def braking_from(self) -> PathState:
        """Where it is commanded to be."""
        return self._follower.state

    def progress(self) -> Progress:
        """How far the path is followed."""
        follower = self._follower
        return Progress(follower.time, follower.speed, follower.position, follower.finished)

    def _save(self, _now: float = 0.0) -> None:
        try:
            if self._robot.unsaved:
                self._robot.save()
                self._saving_fails = False
        except Unavailable as error:
            if not self._saving_fails:
                log.warning("the emulated robot's position is no longer saved reason=%s", error)
            self._saving_fails = True
