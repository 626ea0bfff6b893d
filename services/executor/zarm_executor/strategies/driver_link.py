"""The bus between the executor and a robot's driver: commands out, joint states and progress in."""

from __future__ import annotations

import logging

import numpy as np

from zarm_contract.descriptor import StrategyParams
from zarm_contract.errors import Unavailable
from zarm_contract.keys import Keys
from zarm_contract.messages import DriverCommand
from zarm_contract.robot import RobotDescription
from zarm_executor.strategies.base import Measured
from zarm_executor.strategies.robot_link import RobotLink, on_another_clock, runs_slower
from zarm_runtime import clock
from zarm_runtime.bus import Bus
from zarm_trajectory.trajectory import TimedTrajectory
from zarm_trajectory.turns import whole_turns

log = logging.getLogger(__name__)


_PASSING_ON = 5e-5
"""Time (s) to write one point, send it over 100 Mbit/s and read it, so that a long trajectory does not count as late.
"""
_CLOCK_PATIENCE = 1.0
"""How long (s) after a silence the stamps may mark joints as old; delayed messages arrive within milliseconds."""


class DriverLink(RobotLink):
    """Speaks to the driver that `params` describes, which has an order of joints of its own.

    A driver may report a continuous joint within one turn, and begin another turn at its limit. So `measured` goes on
    counting turns from the joints before, while what is sent goes on from the turn that the driver reports at `begin`.

    `bus` should carry little else: a slow reader of other keys must not hold up the robot.
    """

    def __init__(self, bus: Bus, keys: Keys, robot: RobotDescription, params: StrategyParams) -> None:
        super().__init__(robot.descriptor, params.timing)
        self.params = params
        self.velocity_clamp = np.array(params.velocity or self.velocity_clamp)
        self.acceleration_clamp = np.array(params.acceleration or self.acceleration_clamp)
        self._continuous = robot.continuous
        self._turns = self._begun_at = np.zeros(len(self.joints))
        self._names = params.joint_order or self.joints
        self._columns = [self.joints.index(name) for name in self._names]
        self._key = keys.driver_joint_states
        self._commands = bus.publisher(keys.driver_command)
        self._states = bus.latest(keys.driver_joint_states)
        self._progress = bus.latest(keys.driver_progress)
        self._speed = bus.latest(keys.driver_speed)
        self._sequence = 0
        self._measured: Measured | None = None
        self._stamp: float | None = None
        self._held_up_since: float | None = None
        self._other_clock = False
        self._orders: dict[tuple[str, ...], list[int] | None] = {}

    # -- to the driver --

    def begin(self) -> None:
        """A motion begins from rest: what is sent from now on is in the turns that the driver reports now, as a driver
        that is started again may count anew.
        """
        self.measured()
        self._begun_at = self._turns

    def send(self, points: TimedTrajectory, *, positions_only: bool = False) -> int:
        """Make the driver play these points from now on; returns the command's sequence number.

        The driver drops them if they arrive after the joints on which they are based have expired. Raises Unavailable
        if it has reported none.
        """
        measured = self.measured()
        if measured is None:
            raise Unavailable(f"no driver publishes the robot's joints on {self._key}")
        position, velocity, acceleration = (
            tuple(zip(*rows.T[self._columns].tolist(), strict=True))
            for rows in (points.position - self._begun_at, points.velocity, points.acceleration)
        )
        return self._put(
            DriverCommand(
                sequence=self._sequence + 1,
                joint_names=self._names,
                based_on=measured.stamp,
                expires_after=self.execution.joint_state_timeout + _PASSING_ON * len(points.time),
                time=tuple(points.time.tolist()),
                position=position,
                velocity=() if positions_only else velocity,
                acceleration=() if positions_only else acceleration,
            )
        )

    def stop(self) -> int:
        """Make the driver stop now, by its own means; returns the command's sequence number."""
        return self._put(DriverCommand(sequence=self._sequence + 1, joint_names=self._names))

    def _put(self, command: DriverCommand) -> int:
        self._sequence = command.sequence
        self._commands.put(command)
        return command.sequence

    # -- from the driver --

    def measured(self) -> Measured | None:
        """The newest readable joints, in the executor's order; None before the first.

        A message with the stamp of the previous one is a repetition, not a measurement: a driver that repeats itself
        counts as silent. Stamps are compared with each other, and with this clock only where that is faster than real time.
        """
        received = self._states.received()
        if received is None or (self._measured is not None and received[1] == self._measured.time):
            return self._measured
        state, at = received
        order = self._order(state.joint_names)
        self._other_clock = order is not None and on_another_clock(state.stamp, at)
        if order is None or self._other_clock:
            return self._measured
        if state.stamp != self._stamp and not self._held_up(state.stamp, at):
            self._stamp = state.stamp
            position, velocity = np.array((state.position, state.velocity))[:, order]
            if self._measured is not None:
                self._turns = whole_turns(self._measured.position - position, self._continuous)
                position = position + self._turns
            effort = None if state.effort is None else np.array(state.effort)[order]
            self._measured = Measured(position, velocity, at, state.stamp, effort)
            self._note(self._measured)
        return self._measured

    def _held_up(self, stamp: float, at: float) -> bool:
        """Whether joints received `at` are old: after a silence, messages that were held up arrive first.

        They would make a robot at rest seem to move. Since the previous joints, the driver's clock must have advanced
        as far as this one; if it has not even after `_CLOCK_PATIENCE`, that clock was stepped.
        """
        before, patience = self._measured, self.execution.joint_state_timeout
        if before is None or before.stamp is None:
            return False
        silence = at - before.time
        if silence <= patience or stamp - before.stamp >= silence - patience:
            self._held_up_since = None
            return False
        if self._held_up_since is None:
            self._held_up_since = at
        return at - self._held_up_since <= _CLOCK_PATIENCE

    def fraction(self, sequence: int) -> float | None:
        """The played fraction of the command `sequence`; None if the driver has not reported on it."""
        received = self._progress.received()
        return received[0].fraction if received is not None and received[0].sequence == sequence else None

    def problem(self, sequence: int) -> str | None:
        """Why the driver plays the command `sequence` no further; None if it has not said so."""
        received = self._progress.received()
        return received[0].problem if received is not None and received[0].sequence == sequence else None

    def pace(self) -> float:
        """The share (0..1) of the commanded speed that the robot's own controls allow; 1 unless the driver reports it."""
        received = self._speed.received()
        return 1.0 if received is None else received[0].scale

    def obstacle(self) -> str | None:
        """Why the robot cannot be moved through this driver now; None if it can."""
        measured = self.measured()
        if self._other_clock:
            return runs_slower("the driver")
        if measured is None:
            return f"no driver publishes the robot's joints on {self._key}; start the robot's driver"
        age, limit = clock.monotonic() - measured.time, self.execution.joint_state_timeout
        if age > limit:
            return (
                f"the driver last published the robot's joints {age:.1f} s ago (joint_state_timeout {limit:g} s); see whether "
                "it runs"
            )
        return None

    def _order(self, names: tuple[str, ...]) -> list[int] | None:
        """The index of each of the executor's joints in these names; None if one is missing."""
        if names not in self._orders:
            missing = [joint for joint in self.joints if joint not in names]
            if missing:
                log.warning(
                    "joint states of another robot are ignored key=%s missing=%s has=%s",
                    self._key,
                    ",".join(missing),
                    ",".join(names),
                )
            if len(self._orders) >= 8:  # a sender that keeps changing names must not fill the memory
                self._orders.clear()
            self._orders[names] = None if missing else [names.index(joint) for joint in self.joints]
        return self._orders[names]
