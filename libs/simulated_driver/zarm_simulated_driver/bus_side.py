"""The simulated driver on the bus: the keys `driver/*`."""

from __future__ import annotations

import logging
from collections.abc import Callable

import numpy as np

from zarm_contract.keys import Keys
from zarm_contract.messages import DriverCommand, DriverProgress, JointState
from zarm_runtime import clock
from zarm_runtime.bus import Bus
from zarm_runtime.expiry import Expiry
from zarm_simulated_driver.axes import Axes
from zarm_simulated_driver.driver import Command, PlaybackProgress
from zarm_trajectory.arrays import Array

log = logging.getLogger(__name__)


class BusSide:
    """Commands in, joint states and progress out."""

    def __init__(self, bus: Bus, keys: Keys, axes: Axes) -> None:
        self._bus, self._keys, self._axes = bus, keys, axes
        self._joints = bus.publisher(keys.driver_joint_states)
        self._expiry = Expiry()
        self._progress = bus.publisher(keys.driver_progress)

    def listen(self, play: Callable[[Command], None]) -> None:
        """From now on play the commands that arrive in time."""
        count = len(self._axes.names)

        def received(command: DriverCommand, arrived: float) -> None:
            if not self._expiry.in_time(command, arrived):
                log.warning("dropped a late command sequence=%d points=%d", command.sequence, len(command.time))
                return
            if len(command.joint_names) != count:
                log.warning("ignored a command joints=%d needed=%d", len(command.joint_names), count)
                return
            play(
                Command(
                    command.sequence,
                    np.array(command.position).reshape(-1, count),
                    np.array(command.velocity).reshape(-1, count),
                )
            )

        self._bus.subscribe_timed(self._keys.driver_command, received)

    def publish_joints(self, position: Array, velocity: Array, effort: Array | None) -> None:
        """Publish the joint positions (J,) rad, velocities (J,) rad/s and efforts (J,) Nm, if known."""
        axes, stamp = self._axes, clock.unix_time()
        self._expiry.report(stamp, clock.monotonic())
        self._joints.put(
            JointState(
                stamp=stamp,
                joint_names=axes.reported_joints,
                position=axes.as_reported(position),
                velocity=axes.as_reported(velocity),
                effort=None if effort is None else axes.as_reported(effort),
            )
        )

    def publish_progress(self, progress: PlaybackProgress) -> None:
        """Publish the progress of the driver."""
        self._progress.put(DriverProgress(sequence=progress.sequence, fraction=progress.fraction))
