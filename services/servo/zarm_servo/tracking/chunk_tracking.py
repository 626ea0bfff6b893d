"""Chunks in a session: what they ask for at each step, and how far the robot is behind them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from zarm_contract.messages import ChunkAccepted, JointState, ServoChunk
from zarm_geometry.robot_model import RobotModel
from zarm_runtime import clock
from zarm_servo.kernels.step import PERIOD
from zarm_servo.tracking.chunk_follower import ChunkFollower
from zarm_servo.tracking.chunk_inbox import ChunkInbox
from zarm_servo.tracking.clock import StepTimes
from zarm_servo.tracking.controller import Controller, Limitation, Step, Surroundings
from zarm_servo.tracking.grip_follower import GripFollower
from zarm_servo.tracking.reference import Reference
from zarm_servo.tracking.targets import JointTarget
from zarm_trajectory.limits import Limits

_STEPS_UNTIL_RETRY = 10
"""After a step along a chunk that was not free, so many are taken otherwise before the next is tried."""
_LAG_SPEED = 0.05
"""Slower than this (rad/s), no lag is told."""


class ChunkTracking:
    """Moves the robot of `controller` along the chunks received, within `limits`; `measured` returns where the robot is."""

    def __init__(
        self,
        model: RobotModel,
        limits: Limits,
        controller: Controller,
        grip: GripFollower,
        measured: Callable[[], JointState | None],
    ) -> None:
        self._joints = model.robot.descriptor.joints
        self._inbox, self._follower = ChunkInbox(model, limits), ChunkFollower(limits)
        self._controller, self._grip, self._measured = controller, grip, measured
        self._times, self._next = StepTimes(), clock.monotonic()
        self._apart = 0
        self._last: Reference | None = None

    @property
    def sequence(self) -> int:
        """The number of the newest chunk, 0 before the first."""
        return self._inbox.sequence

    def active(self, now: float) -> bool:
        """Whether a chunk is followed at `now` (s, monotonic)."""
        return self._inbox.at(now) is not None

    def take(self, chunk: ServoChunk, limitation: Limitation) -> ChunkAccepted:
        """Accept a chunk; `limitation` is what limits the robot at present. Raises InvalidRequest, see `ChunkInbox.receive`."""
        now, unix = clock.monotonic(), clock.unix_time()
        taken = self._inbox.receive(chunk, now, unix, max(self._next, now), self._controller.state[0])
        link, other = limitation.pair or (None, None)
        return ChunkAccepted(
            late=taken.late,
            lost=taken.lost,
            jump=taken.jump,
            clipped=taken.clipped,
            observation_age=taken.observation_age,
            limiting=limitation.kind,
            link=link,
            object=other,
            distance=limitation.distance,
            lag=self.lag(),
        )

    def lag(self) -> float | None:
        """How far (s) the measured robot is behind its chunk; None at rest and without one."""
        measured = self._measured()
        if measured is None or set(measured.joint_names) != set(self._joints):
            return None
        when = clock.monotonic() - (clock.unix_time() - measured.stamp)
        reference = self._inbox.at(when)
        if reference is None:
            return None
        there, velocity, _ = reference.sample(np.array([when]))[:, 0]
        square = float(velocity @ velocity)
        if square < _LAG_SPEED**2:
            return None
        position = np.array([measured.position[measured.joint_names.index(joint)] for joint in self._joints])
        return float((there - position) @ velocity) / square

    def learn_lag(self) -> None:
        """Make up for the lag of a robot that follows its chunk."""
        lag = self.lag() if self._apart <= 0 else None
        if lag is not None:
            self._times.learn(lag)

    def step(self, expected: float, rate: float, around: Surroundings, limitation: Limitation) -> Step | None:
        """The next step, `expected` to be taken at that time (s, monotonic) by a robot whose time passes at 1 / `rate` of that, after one that
        `limitation` limited; None without a chunk.
        """
        self._next = when = self._times.next(PERIOD * rate, expected)
        reference = self._inbox.at(when)
        if reference is None:
            if self._last is not None:  # the gripper is behind the steps, which are ahead of now
                self._grip.follow(self._last, when)
                self._last = None
            return None
        self._last = reference
        self._grip.follow(reference, clock.monotonic())
        return self._along(reference, when, rate, around, limitation)

    def _along(
        self, reference: Reference, when: float, rate: float, around: Surroundings, limitation: Limitation
    ) -> Step:
        """A step to where the chunk is at the time `when` (s); where the way there is not free, one that slows down or slides."""
        self._apart -= 1
        if self._apart <= 0 and limitation.kind in ("free", "target_stale"):
            after = self._follower.next(self._controller.state, reference, when - PERIOD * rate, rate)
            step = None if after is None else self._controller.follow(after, around)
            if step is not None:
                return step
            self._apart = _STEPS_UNTIL_RETRY
        position, velocity, _ = reference.sample(np.array([when]), rate)[:, 0]
        return self._controller.step(JointTarget(position, velocity), 0.0, around)
