"""The simulated driver: an arm behind a bus, and the faults that it can be given."""

from __future__ import annotations

import logging
import os
import random
import threading
import time
from collections import deque
from collections.abc import Callable
from typing import TextIO

import numpy as np

from zarm_contract.errors import InvalidRequest
from zarm_contract.messages import DriverCommand, DriverFault, DriverProgress, JointState, Nothing
from zarm_leeloo_sim.player import STEP, Player

log = logging.getLogger(__name__)

LONGEST_PAUSE = 0.1
"""An arm that was not simulated for longer (s), as while its process is stopped, has not moved meanwhile."""


class Driver:
    """Plays commands on `player` and tells joint states and progress.

    `order` are the joints by index, as the points of a command have them; `told` the order in which they are told. `trace`
    gets a line for every step: positions (rad), then velocities (rad/s), in `order`, whatever faults keep from the bus.
    """

    def __init__(
        self,
        player: Player,
        order: tuple[str, ...],
        told: tuple[str, ...],
        tell_joints: Callable[[JointState], None],
        tell_progress: Callable[[DriverProgress], None],
        trace: TextIO | None = None,
    ) -> None:
        self._player = player
        self._order = order
        self._told = told
        self._columns = [order.index(name) for name in told]
        self._tell_joints = tell_joints
        self._tell_progress = tell_progress
        self._trace = trace
        self._fault = DriverFault()
        self._random = random.Random(1)  # noqa: S311  which commands get lost is no secret
        self._waiting: deque[tuple[float, DriverCommand]] = deque()
        self._sequence = 0
        self._fraction_told = 1.0
        self._lock = threading.Lock()

    def command(self, _key: str, command: DriverCommand) -> None:
        """Play this from the next tick on, or later where a fault delays it."""
        if len(command.joint_names) != len(self._order):
            log.warning("ignored a command joints=%d needed=%d", len(command.joint_names), len(self._order))
            return
        with self._lock:
            if self._random.random() >= self._fault.drop:
                self._waiting.append((time.monotonic() + self._fault.delay, command))

    def suffer(self, fault: DriverFault) -> Nothing:
        """Have this fault from now on, and no other. Raises InvalidRequest for a jump of other joints."""
        if fault.jump is not None and len(fault.jump) != len(self._order):
            raise InvalidRequest(
                f"{len(fault.jump)} values for {len(self._order)} joints; give one for each", field="jump"
            )
        with self._lock:
            log.info("fault %s", fault.model_dump_json(exclude_defaults=True))
            if fault.die:
                os._exit(1)
            self._fault = fault
            if fault.jump is not None:
                self._player.position = self._player.position + np.array(fault.jump)
        return Nothing()

    def state(self) -> JointState:
        """The joints now, in the order in which they are told."""
        return JointState(
            stamp=time.time(),
            joint_names=self._told,
            position=tuple(self._player.position[self._columns].tolist()),
            velocity=tuple(self._player.velocity[self._columns].tolist()),
        )

    def run(self, ended: threading.Event) -> None:
        """Simulate in step with the monotonic clock until `ended`."""
        deadline = time.monotonic()
        while not ended.is_set():
            time.sleep(max(0.0, deadline - time.monotonic()))
            if time.monotonic() - deadline > LONGEST_PAUSE:
                deadline = time.monotonic()
            self._step(deadline)
            deadline += STEP

    def _step(self, now: float) -> None:
        with self._lock:
            while self._waiting and self._waiting[0][0] <= now:
                self._take(self._waiting.popleft()[1])
            self._player.step(stalled=self._fault.stall)
            if self._trace is not None:
                row = (*self._player.position.tolist(), *self._player.velocity.tolist())
                self._trace.write(",".join(map(repr, row)) + "\n")
            if self._fault.silent:
                return
            self._tell_joints(self.state())
            fraction = self._player.fraction
            if self._sequence and fraction != self._fraction_told and not self._fault.stall:
                self._fraction_told = fraction
                self._tell_progress(DriverProgress(sequence=self._sequence, fraction=fraction))

    def _take(self, command: DriverCommand) -> None:
        joints = len(self._order)
        self._player.play(
            np.array(command.position).reshape(-1, joints), np.array(command.velocity).reshape(-1, joints)
        )
        self._sequence, self._fraction_told = command.sequence, 0.0
