"""The strategy that sends a whole trajectory, as for ros2_control's JointTrajectoryController."""

from __future__ import annotations

from enum import Enum, auto

import numpy as np

from zarm_executor.strategies.base import Measured, Progress
from zarm_executor.strategies.driver import DriverStrategy
from zarm_executor.strategies.driver_link import DriverLink
from zarm_trajectory.follower import CATCH_UP, Follower
from zarm_trajectory.path_state import PathState
from zarm_trajectory.retimed import RetimedTrajectory
from zarm_trajectory.trajectory import TimedTrajectory

_WINDOW = 0.5
"""Window (s of the command) around the last place in which the robot is searched for on its path."""
_OVERRUN = 0.3
"""Margin (s of path time) before and after the commanded braking within which the robot may have come to rest."""
_UNREPORTED_POINTS = 2.0
"""For a driver that does not report the point it plays, braking begins this many points earlier. Its assumed point is
wrong by two at most, and within its limits an accelerating robot may go back two points at once, from v to v - a dt,
but not forward, to v + 2 a dt.
"""
_LEARNS = 2.0
"""Points that may pass until the braking point is known and the driver has received it."""
_PACE_PERIOD = 0.1
"""Least time (s) between two sends of the rest of a trajectory at another path speed."""
_ON_TIME = 0.1
"""If the robot is this much (s) more than `delay` behind its driver's clock, the driver is not on time."""
_UNTAKEN = 0.3
"""A trajectory was late or lost if the driver has reported nothing on it for this long (s) while the robot stands."""
_SILENT = 0.3
"""A driver that has reported no further point for this long (s), while the robot stands at the end of its path, will
report none.
"""
_ENCODING = 12e-6
"""Time (s) to send one point: measured, 36 ms for 3000 points of six joints."""


class _Phase(Enum):
    """What the driver is told: to play the path, or to brake along it."""

    PLAYING = auto()
    STOPPING = auto()
    """Playing, until the point is known from which to brake."""
    BRAKING = auto()
    RESUMING = auto()
    """Braking, until the point is known, or the robot rests, from which to play the rest."""


class JointTrajectory(DriverStrategy):
    """Sends the path once. A stop is a new trajectory that brakes along the path, or an empty one if `stop` is `empty`.

    The driver reports the robot's progress; if it does not (no `state_topic`), progress is the path point nearest to
    the measured joints. During braking it is taken from the clock, so that a silent driver keeps no goal from ending.
    """

    name = "joint_trajectory"
    link: DriverLink

    def __init__(self, link: DriverLink) -> None:
        super().__init__(link)
        self._trajectory: TimedTrajectory | None = None
        self._command: RetimedTrajectory | None = None
        self._sequence: int | None = None
        self._sent_at = 0.0
        self._index = 0.0
        self._clock = 0.0
        self._reported = 0.0
        self._reported_at = 0.0
        self._gone_on = False
        self._phase = _Phase.PLAYING
        self._unsent = False
        self._speed = 1.0
        self._repacing = False
        self._waited = 0.0
        self._lost_at: float | None = None
        self._back_at = -np.inf

    def start(self, trajectory: TimedTrajectory, speed: float) -> None:
        """Play the whole of `trajectory` from the next tick on."""
        self.link.begin()
        self._trajectory, self._speed = trajectory, speed
        self._phase = _Phase.PLAYING
        self._lost_at = None
        self._play(self._along(trajectory, PathState(trajectory.begin, speed), speed))

    def stop(self) -> None:
        """Brake along the path from the next tick on."""
        if self._phase is _Phase.RESUMING:
            self._phase = _Phase.BRAKING
        elif self._phase is _Phase.PLAYING and self._command is not None:
            self._phase, self._waited = _Phase.STOPPING, 0.0

    def move(self, speed: float) -> None:
        """Play the rest of the path at this path speed.

        It begins where the robot came to rest, or where the driver will be in what it is playing or braking through.
        """
        self._repacing = self._repacing or speed != self._speed
        self._speed = speed
        self._phase = _Phase.RESUMING if self._brakes else _Phase.PLAYING

    def tick(self, now: float, dt: float) -> None:
        """See how far the driver is, and send what is to be played next."""
        self.look()
        command = self._command
        if command is None:
            return
        if dt > CATCH_UP:
            self._back_at = now
        is_reporting = self.link.is_reporting(now)
        if not is_reporting and now - self._back_at <= self.link.execution.joint_state_timeout:
            return  # the executor stood still: the driver's messages from that time are still unread
        if not is_reporting or self._lost_at is not None:
            self._brake_unheard(now)
            return
        if not self._unsent:
            self._clock = (now - self._sent_at) / command.dt
            reported = self._reported_index(command)
            self._gone_on, self._reported = reported > self._reported, reported
            if self._gone_on:
                self._reported_at = now
            self._index = min(max(self._index, self._reached(command, dt)), command.last)
            if self._ended_unreported(command, now):
                self._index = command.last
                self.link.stop()  # a driver with points left must not continue with them
        if self._phase is _Phase.STOPPING:
            self._brake(command, now, dt)
        elif self._phase is _Phase.RESUMING:
            self._resume(command, dt)
        elif self._phase is _Phase.PLAYING and self._repacing:
            self._repace(command, now, dt)
        if self._unsent or self._untaken(now):
            self._transmit(now)
        elif self._brakes and self._index == command.last:
            self.hold(now)

    def braking_from(self) -> PathState:
        """Where the driver will be when it receives the command, which takes a point or two."""
        command = self._command
        return PathState(0.0, 0.0) if command is None else command.at(self._playing(command) + _LEARNS)

    def problem(self) -> str | None:
        """What the controller says of the trajectory that it refused or gave up."""
        return None if self._sequence is None or self._brakes or self._unsent else self.link.problem(self._sequence)

    def progress(self) -> Progress:
        """How far the robot is."""
        trajectory, command = self._trajectory, self._command
        if trajectory is None or command is None:
            return Progress(time=0.0, speed=0.0, command=np.zeros(len(self.link.joints)), finished=True)
        time, speed, _ = command.at(self._index)
        over = self._lost_at is None and self._phase is not _Phase.RESUMING
        return Progress(time, speed, command.position(self._index), finished=over and time >= trajectory.duration)

    @property
    def _brakes(self) -> bool:
        """Whether the driver was told to brake."""
        return self._phase in (_Phase.BRAKING, _Phase.RESUMING)

    def _brake_unheard(self, now: float) -> None:
        """While the driver is not heard, tell it to stop by its own means, until it is heard again and the robot
        stands.

        Anything still to be sent is dropped, because it would start from where the robot no longer is. A motion that
        was not told to stop continues from where the robot stands.
        """
        if self.progress().finished and self._phase is _Phase.PLAYING:
            return
        measured = self.link.measured()
        if self._lost_at is None:
            self._lost_at = now if measured is None else measured.time
        goes_on = self._phase in (_Phase.PLAYING, _Phase.RESUMING)
        self._phase, self._unsent = _Phase.RESUMING if goes_on else _Phase.BRAKING, False
        self.hold(now)
        if self._trajectory is not None and measured is not None and self.link.is_reporting(now):
            self._find(self._trajectory, measured, now - self._lost_at)
            self._lost_at = None if self.link.standing() else now

    def _find(self, trajectory: TimedTrajectory, measured: Measured, unseen: float) -> None:
        """Move the motion to the place on its path of the robot, which brakes by itself and was not seen for `unseen`
        s.
        """
        time, speed = self.progress().time, 0.0 if self.link.standing() else 1.0
        time = trajectory.nearest(measured.position, time - _OVERRUN, time + _OVERRUN + unseen)
        self._command = self._along(trajectory, PathState(time, speed), speed).ahead(self.link.params.point_dt, 1)
        self._index = self._clock = 0.0

    def _untaken(self, now: float) -> bool:
        """Whether a driver that reports its progress has missed the trajectory that starts a motion, so that it is sent
        again.
        """
        return (
            self.link.params.state_topic is not None
            and not self._brakes
            and self._sequence is not None
            and self.link.fraction(self._sequence) is None
            and now - self._sent_at > _UNTAKEN
            and self.link.standing()
        )

    def _brake(self, command: RetimedTrajectory, now: float, dt: float) -> None:
        """Brake from where the driver will be when it receives the command."""
        index = self._index if self._unsent else self._brakes_from(command, now, dt)
        if index is None:
            self._waited += dt
            return
        self._phase = _Phase.BRAKING
        if self._trajectory is not None:
            self._play(self._along(self._trajectory, command.at(min(index, command.last)), 0.0))

    def _brakes_from(self, command: RetimedTrajectory, now: float, dt: float) -> float | None:
        """The index of the point from which to brake; None while it may still become known, which takes a point at
        most.
        """
        if not self._late(command) and self.link.params.stop != "empty":
            known = self._next(command, dt)
            if known is not None or self._waited < command.dt:
                return known
        index = self._playing(command)
        return index - _UNREPORTED_POINTS if self.link.params.state_topic is None else index

    def _resume(self, command: RetimedTrajectory, dt: float) -> None:
        """Play the rest of the path, from where the robot came to rest or is in its braking."""
        trajectory = self._trajectory
        if trajectory is None:
            return
        if self._index == command.last:
            # The driver lagged behind, so the robot may have come to rest elsewhere than computed.
            measured, time = self.link.measured(), float(command.path_time[-1])
            if measured is not None:
                time = trajectory.nearest(measured.position, command.path_time[0] - _OVERRUN, time + _OVERRUN)
            self._play(self._along(trajectory, PathState(time, 0.0), self._speed))
            self._lead_back()
        elif self.link.params.stop == "empty":
            return  # the driver brakes along an unknown path
        else:
            index = self._next(command, dt, encoded=(trajectory.duration - float(command.path_time[-1])) / command.dt)
            if index is None:
                return
            self._play(self._along(trajectory, command.at(index), self._speed))
        self._phase = _Phase.PLAYING

    def _repace(self, command: RetimedTrajectory, now: float, dt: float) -> None:
        """Play the rest at the new path speed, from where the driver will be when it receives it."""
        if self._trajectory is None or (not self._unsent and now - self._sent_at < _PACE_PERIOD):
            return
        index = self._index if self._unsent else self._next(command, dt, encoded=command.last - self._index)
        if index is None:
            return
        state = command.at(index)
        self._repacing = False
        if state.time < self._trajectory.duration:
            if self._unsent:
                state = PathState(state.time, self._speed)
            self._play(self._along(self._trajectory, state, self._speed))

    def _next(self, command: RetimedTrajectory, dt: float, encoded: float = 0.0) -> float | None:
        """The index of the next point when the driver receives what is sent in this tick; None if that is unknown.

        A driver plays whole points, at its own times. If it reports them, the time of a point is known when it has just
        reported one, but not in the ticks (of `dt` s) in between. If it reports nothing, it began to play as long after
        receiving a command as it will now, so it is a whole number of points on in a tick in which that many have
        passed. Encoding `encoded` points first makes it later.
        """
        encoding = _ENCODING * encoded / command.dt
        if self.link.params.state_topic is not None:
            return self._reported + 1.0 + int(encoding) if self._gone_on else None
        if self._late(command):
            return self._playing(command) + int(encoding)
        due = self._clock + encoding - _ENCODING * len(command) / command.dt
        return float(round(due)) if abs(due - round(due)) * command.dt <= dt / 2 else None

    def _playing(self, command: RetimedTrajectory) -> float:
        """The index of the point that the driver plays when it receives a command.

        It is one beyond the last reported point. A driver that reports nothing is on time, unless the robot lags more
        than normal: then the driver is slower than commanded, and `delay` ahead of the robot.
        """
        if self.link.params.state_topic is not None:
            return self._index + 1.0
        return self._index + self.link.params.delay / command.dt if self._late(command) else self._clock + 1.0

    def _late(self, command: RetimedTrajectory) -> bool:
        """Whether a driver that reports nothing is not on time: the robot lags more than normal."""
        behind = (self._clock - self._index) * command.dt
        return self.link.params.state_topic is None and behind > self.link.params.delay + _ON_TIME

    def _along(self, trajectory: TimedTrajectory, state: PathState, target: float) -> Follower:
        time, speed, rate = state
        return Follower(trajectory, self.link.limits, time=time, speed=speed, rate=rate, target=target)

    def _transmit(self, now: float) -> None:
        if self._command is None:
            return
        # A robot at rest must not start to move in order to brake.
        empty = self._brakes and (self.link.params.stop == "empty" or self.link.standing())
        self._sequence = self.link.stop() if empty else self.link.send(self._command.points)
        self._sent_at = now
        self.sent(now)
        self._unsent = False

    def _play(self, follower: Follower) -> None:
        self._command = follower.ahead(self.link.params.point_dt)
        self._index = self._clock = self._reported = 0.0
        self._unsent = True
        self._repacing = self._repacing and follower.target != self._speed

    def _reached(self, command: RetimedTrajectory, dt: float) -> float:
        """The index of the point that the robot has reached."""
        if self._brakes:
            return self._clock - self.link.params.delay / command.dt
        if self.link.params.state_topic is None:
            window = max(_WINDOW, dt) / command.dt
            return self._nearest(self._index - window, min(self._index + window, self._clock))
        return self._reported

    def _ended_unreported(self, command: RetimedTrajectory, now: float) -> bool:
        """Whether the robot rests at the end of its path although its driver has not reported it: progress messages may
        get lost.

        From the last reported point on, the path must not leave its end, so that the robot does not still have to come
        back to it.
        """
        measured, execution = self.link.measured(), self.link.execution
        if measured is None or self._trajectory is None or self._brakes or self._index == command.last:
            return False
        if (
            self._reported <= 0.0
            or self._clock < command.last
            or now - self._reported_at < _SILENT
            or not self.link.standing()
        ):
            return False
        end, left = self._trajectory.end, command.points.position[int(self._reported) :]
        there = np.abs(measured.position - end) <= execution.goal_tolerance
        return bool(there.all() and np.all(np.abs(left - end) <= execution.path_tolerance))

    def _reported_index(self, command: RetimedTrajectory) -> float:
        """The index of the last point that the driver reported; 0 before the first."""
        fraction = None if self._sequence is None else self.link.fraction(self._sequence)
        return 0.0 if fraction is None else fraction * len(command) - 1.0

    def _nearest(self, first: float, last: float) -> float:
        """The index, in this range, of the point nearest to the measured robot.

        Among equally near points, the last: a robot may rest slightly beside the end, and a path may stand still.
        """
        measured, command = self.link.measured(), self._command
        if measured is None or command is None:
            return 0.0
        begin = max(int(first), 0)
        distance = np.abs(command.points.position[begin : int(max(last, 0.0)) + 1] - measured.position).max(axis=1)
        about = distance.min() + self.link.execution.goal_tolerance / 2
        return float(begin + np.flatnonzero(distance <= about)[-1])

    def _lead_back(self) -> None:
        """A robot that braked by itself stands beside the path: insert the way back to it before the rest of the path."""
        measured, command = self.link.measured(), self._command
        if measured is None or command is None:
            return
        limits = self.link.velocity_clamp, self.link.limits.acceleration, self.link.limits.jerk
        way = TimedTrajectory.standing(command.points.position[0]).approached_from(measured.position, *limits)
        times = np.arange(0.0, way.duration - 1.0, command.dt)  # without the final second of rest
        held = np.zeros_like(times)
        states = np.concatenate((way.sample(times), command.points.states), axis=1)
        self._command = RetimedTrajectory(
            command.dt,
            np.concatenate((held + command.path_time[0], command.path_time)),
            np.concatenate((held, command.path_speed)),
            np.concatenate((held, command.path_rate)),
            TimedTrajectory(np.arange(float(states.shape[1])) * command.dt, *states),
        )
