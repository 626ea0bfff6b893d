"""A simulated driver: an arm in step with the clock, and its faults. It depends on neither bus nor ROS."""

from __future__ import annotations

import logging
import os
import random
import threading
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol, TextIO

import numpy as np

from zarm_contract.errors import InvalidRequest
from zarm_contract.messages import (
    DriverFault,
    DriverGripperCommand,
    DriverGripperState,
    DriverOutputCommand,
    DriverOutputState,
    Nothing,
    Vector3,
)
from zarm_runtime import clock
from zarm_simulated_driver.player import STEP
from zarm_trajectory.arrays import Array

log = logging.getLogger(__name__)

LONGEST_PAUSE = 0.1
"""An arm that was not simulated for longer than this (s), as when its process is stopped, has not moved meanwhile."""


class Arm(Protocol):
    """J joints that play points."""

    @property
    def position(self) -> Array:
        """Measured positions (J,), rad."""
        ...

    @property
    def velocity(self) -> Array:
        """Measured velocities (J,), rad/s."""
        ...

    @property
    def effort(self) -> Array | None:
        """Mean torques (J,) of the drives in the last step, Nm; None if there are none."""
        ...

    @property
    def played(self) -> int:
        """How many points of the last command are played."""
        ...

    @property
    def total(self) -> int:
        """How many points the last command had."""
        ...

    def play(self, positions: Array, velocities: Array) -> int:
        """Play these points, see `Player.play`."""
        ...

    def step(self, *, stalled: bool = False) -> None:
        """Let `STEP` seconds pass; a stalled arm plays no further point and brakes to rest."""
        ...

    def displace(self, offset: Array) -> None:
        """Jump by `offset` (J,) rad, to simulate a fault."""
        ...

    def push(self, force: Vector3 | None) -> None:
        """From now on push the tip with this force (N, base frame). Raises InvalidRequest for an arm without mass."""
        ...


class Hands(Protocol):
    """The grippers of a robot."""

    def play(self, command: DriverGripperCommand) -> None:
        """Move to this from the next step on."""
        ...

    def step(self, dt: float, obstacle: float | None, report: Callable[[DriverGripperState], None]) -> None:
        """Report after `dt` s in which fingers do not close further than `obstacle` (m)."""
        ...


@dataclass(frozen=True)
class Command:
    """Points to play instead of the remaining ones, as in `Player.play`; `sequence` is its number."""

    sequence: int
    position: Array
    velocity: Array


@dataclass(frozen=True)
class PlaybackProgress:
    """How many of the points of command `sequence` are played."""

    sequence: int
    played: int
    total: int

    @property
    def fraction(self) -> float:
        """Points played / points received; 1 if it had none."""
        return self.played / self.total if self.total else 1.0


class SimulatedDriver:
    """Plays commands on `arm`; publishes positions (J,) rad, velocities (J,) rad/s and efforts (J,) Nm, and progress.

    `hands` are its grippers, whose states go to `publish_gripper`. `trace` gets a line for every step: positions, then
    velocities, regardless of faults that hide them from others.
    """

    def __init__(
        self,
        arm: Arm,
        publish_joints: Callable[[Array, Array, Array | None], None],
        publish_progress: Callable[[PlaybackProgress], None],
        hands: Hands,
        publish_gripper: Callable[[DriverGripperState], None],
        trace: TextIO | None = None,
    ) -> None:
        self._arm = arm
        self._hands, self._publish_gripper = hands, publish_gripper
        self._publish_joints = publish_joints
        self._publish_progress = publish_progress
        self._trace = trace
        self._fault = DriverFault()
        self._random = random.Random(1)  # noqa: S311  which commands get lost is no secret
        self._waiting: deque[tuple[float, Command]] = deque()
        self._sequence = 0
        self._fraction_reported = 1.0
        self._lock = threading.Lock()

    def play(self, command: Command) -> None:
        """Play this from the next tick on, or later if a fault delays it."""
        with self._lock:
            if self._random.random() >= self._fault.drop:
                self._waiting.append((clock.monotonic() + self._fault.delay, command))

    def grip(self, command: DriverGripperCommand) -> None:
        """Move a gripper."""
        with self._lock:
            self._hands.play(command)

    def switch(self, command: DriverOutputCommand) -> DriverOutputState | None:
        """What becomes of the command to an output; None if nobody is told."""
        if self._fault.silent:
            return None
        problem = f"{command.output} has no power" if command.output == self._fault.output else None
        return DriverOutputState(output=command.output, sequence=command.sequence, problem=problem)

    def set_fault(self, fault: DriverFault) -> Nothing:
        """Apply this fault from now on, and no other. Raises InvalidRequest for a jump with the wrong joints, and as `Arm.push` does."""
        if fault.jump is not None and len(fault.jump) != len(self._arm.position):
            raise InvalidRequest(
                f"{len(fault.jump)} values for {len(self._arm.position)} joints; give one for each", field="jump"
            )
        with self._lock:
            log.info("fault %s", fault.model_dump_json(exclude_defaults=True))
            if fault.die:
                os._exit(1)
            self._arm.push(fault.push)
            self._fault = fault
            if fault.jump is not None:
                self._arm.displace(np.array(fault.jump))
        return Nothing()

    def run(self, ended: threading.Event) -> None:
        """Simulate in step with the monotonic clock until `ended`."""
        deadline = clock.monotonic()
        while not ended.is_set():
            clock.sleep(max(0.0, deadline - clock.monotonic()))
            if clock.monotonic() - deadline > LONGEST_PAUSE:
                deadline = clock.monotonic()
            self._step(deadline)
            deadline += STEP

    def _step(self, now: float) -> None:
        with self._lock:
            while self._waiting and self._waiting[0][0] <= now:
                self._take(self._waiting.popleft()[1])
            self._arm.step(stalled=self._fault.stall)
            if self._trace is not None:
                row = (*self._arm.position.tolist(), *self._arm.velocity.tolist())
                self._trace.write(",".join(map(repr, row)) + "\n")
            self._hands.step(0.0 if self._fault.stall else STEP, self._fault.obstacle, self._report_gripper)
            if self._fault.silent:
                return
            self._publish_joints(self._arm.position, self._arm.velocity, self._arm.effort)
            progress = PlaybackProgress(self._sequence, self._arm.played, self._arm.total)
            if self._sequence and progress.fraction != self._fraction_reported and not self._fault.stall:
                self._fraction_reported = progress.fraction
                self._publish_progress(progress)

    def _report_gripper(self, state: DriverGripperState) -> None:
        if not self._fault.silent:
            self._publish_gripper(state)

    def _take(self, command: Command) -> None:
        if lacking := self._arm.play(command.position, command.velocity):
            log.warning("points that lack what is played repeat the one before points=%d", lacking)
        self._sequence, self._fraction_reported = command.sequence, 0.0
