"""The strategy that sends a whole trajectory, as for ros2_control's JointTrajectoryController."""

from __future__ import annotations

import numpy as np

from zarm_executor.strategies.base import Measured, Progress
from zarm_executor.strategies.driver import DriverStrategy
from zarm_executor.strategies.driver_link import DriverLink
from zarm_trajectory.follower import CATCH_UP, Follower
from zarm_trajectory.path_state import PathState
from zarm_trajectory.retimed import RetimedTrajectory
from zarm_trajectory.trajectory import TimedTrajectory

_WINDOW = 0.5
"""How far (s of the command) around where it was last the robot is looked for on its path."""
_OVERRUN = 0.3
"""How far (s of the path) before and behind the braking that was commanded the robot may have come to rest."""
_UNTOLD = 2.0
"""So many points earlier begins the braking of a driver that does not say which point it plays. What is assumed of it is wrong by
two points at most, and a robot that speeds up may go back by two at once inside its limits: from v to v - a dt. Forward, v + 2 a dt,
it may not."""
_LEARNS = 2.0
"""So many points may pass until it is known from which one to brake, and the driver has that."""
_PACE_PERIOD = 0.1
"""The rest of a trajectory is sent with another path speed this long (s) after the last one at the earliest."""
_ON_TIME = 0.1
"""A robot that is this long (s) more than `delay` behind its driver's clock has a driver that is not on time."""
_UNTAKEN = 0.3
"""A trajectory of which the driver has told nothing for so long (s), while the robot stands, was late or lost."""
_SILENT = 0.3
"""A driver that has told of no further point for so long (s), while the robot stands at the end of its path, tells of none any more."""
_ENCODING = 12e-6
"""Time (s) that it takes to send one point: measured, 36 ms for 3000 points of six joints."""


class JointTrajectory(DriverStrategy):
    """Sends the path once. A stop is a new trajectory that brakes along the path, or an empty one where `stop` is `empty`.

    How far the robot is, the driver says; where it does not (no `state_topic`), it is the point of the path that is
    nearest to the measured joints. While it brakes the clock says it, so that a silent driver keeps no goal from its end.
    """

    name = "joint_trajectory"

    def __init__(self, link: DriverLink) -> None:
        super().__init__(link)
        self._trajectory: TimedTrajectory | None = None
        self._command: RetimedTrajectory | None = None
        self._sequence: int | None = None
        self._sent_at = 0.0
        self._index = 0.0
        self._clock = 0.0
        self._told = 0.0
        self._told_at = 0.0
        self._gone_on = False
        self._braking = False
        self._unsent = False
        self._speed = 1.0
        self._repacing = False
        self._stopping = False
        self._waited = 0.0
        self._resuming = False
        self._lost_at: float | None = None
        self._back_at = -np.inf

    def start(self, trajectory: TimedTrajectory, speed: float) -> None:
        """Have the whole of `trajectory` played from the next tick on."""
        self._trajectory, self._speed = trajectory, speed
        self._braking = self._stopping = self._resuming = False
        self._lost_at = None
        self._play(self._along(trajectory, PathState(trajectory.begin, speed), speed))

    def stop(self) -> None:
        """Have the robot brake along the path, from the next tick on."""
        self._resuming = False
        if not self._stopping:
            self._stopping = self._command is not None and not self._braking
            self._waited = 0.0

    def move(self, speed: float) -> None:
        """Have the rest of the path played at this path speed.

        It begins where the robot came to rest, or where the driver will be in what it is playing or braking through.
        """
        self._stopping = False
        self._repacing = self._repacing or speed != self._speed
        self._speed = speed
        self._resuming = self._braking

    def tick(self, now: float, dt: float) -> None:
        """See how far the driver is, and send what is to be played next."""
        self.look()
        command = self._command
        if command is None:
            return
        if dt > CATCH_UP:
            self._back_at = now
        heard = self.link.heard(now)
        if not heard and now - self._back_at <= self.link.execution.joint_state_timeout:
            return  # the executor stood still: what the driver told meanwhile is still to be read
        if not heard or self._lost_at is not None:
            self._brake_unheard(now)
            return
        if not self._unsent:
            self._clock = (now - self._sent_at) / command.dt
            told = self._told_of(command)
            self._gone_on, self._told = told > self._told, told
            if self._gone_on:
                self._told_at = now
            self._index = min(max(self._index, self._reached(command, dt)), command.last)
            if self._ended_untold(command, now):
                self._index = command.last
                self.link.stop()  # a driver that has points left after all must not go on with them
        if self._stopping:
            self._brake(command, now, dt)
        elif self._resuming:
            self._resume(command, dt)
        elif self._repacing and not self._braking:
            self._repace(command, now, dt)
        if self._unsent or self._untaken(now):
            self._transmit(now)
        elif self._braking and self._index == command.last:
            self.hold(now)

    def braking_from(self) -> PathState:
        """Where the driver will be when it learns of it, which takes a point or two."""
        command = self._command
        return PathState(0.0, 0.0) if command is None else command.at(self._playing(command) + _LEARNS)

    def progress(self) -> Progress:
        """How far the robot is."""
        trajectory, command = self._trajectory, self._command
        if trajectory is None or command is None:
            return Progress(time=0.0, speed=0.0, command=np.zeros(len(self.link.joints)), finished=True)
        time, speed, _ = command.at(self._index)
        over = self._lost_at is None and not self._resuming
        return Progress(time, speed, command.position(self._index), finished=over and time >= trajectory.duration)

    def _brake_unheard(self, now: float) -> None:
        """Where the driver is not heard it is told to stop, by its own means, until it is heard again and the robot stands.

        What was to be sent is forgotten: it would start from where the robot is no longer. What nobody has told to stop goes on
        from where the robot stands.
        """
        stopped = self._stopping or self._braking
        if self.progress().finished and not stopped:
            return
        measured = self.link.measured()
        if self._lost_at is None:
            self._lost_at = now if measured is None else measured.time
        self._resuming = self._resuming or not stopped
        self._stopping = self._unsent = False
        self._braking = True
        self.hold(now)
        if self._trajectory is not None and measured is not None and self.link.heard(now):
            self._find(self._trajectory, measured, now - self._lost_at)
            self._lost_at = None if self.link.standing() else now

    def _find(self, trajectory: TimedTrajectory, measured: Measured, unseen: float) -> None:
        """Put the motion where the robot is, which brakes by itself, on its path; it was not seen for `unseen` s."""
        time, speed = self.progress().time, 0.0 if self.link.standing() else 1.0
        time = trajectory.nearest(measured.position, time - _OVERRUN, time + _OVERRUN + unseen)
        self._command = self._along(trajectory, PathState(time, speed), speed).ahead(self.link.params.point_dt, 1)
        self._index = self._clock = 0.0

    def _untaken(self, now: float) -> bool:
        """Whether a driver that tells its progress has not taken the trajectory that starts a motion, so that it is sent again."""
        return (
            self.link.params.state_topic is not None
            and not self._braking
            and self._sequence is not None
            and self.link.fraction(self._sequence) is None
            and now - self._sent_at > _UNTAKEN
            and self.link.standing()
        )

    def _brake(self, command: RetimedTrajectory, now: float, dt: float) -> None:
        """Brake from where the driver will be when it learns of it."""
        index = self._index if self._unsent else self._brakes_from(command, now, dt)
        if index is None:
            self._waited += dt
            return
        self._stopping = False
        self._braking = True
        if self._trajectory is not None:
            self._play(self._along(self._trajectory, command.at(min(index, command.last)), 0.0))

    def _brakes_from(self, command: RetimedTrajectory, now: float, dt: float) -> float | None:
        """The index of the point from which to brake; None as long as it may become known, which takes a point at most."""
        if not self._late(command) and self.link.params.stop != "empty":
            known = self._next(command, dt)
            if known is not None or self._waited < command.dt:
                return known
        index = self._playing(command)
        return index - _UNTOLD if self.link.params.state_topic is None else index

    def _resume(self, command: RetimedTrajectory, dt: float) -> None:
        """Have the rest of the path played, from where the robot came to rest or is in its braking."""
        trajectory = self._trajectory
        if trajectory is None:
            return
        if self._index == command.last:
            # Where the robot came to rest is not just where it should have: the driver was on its way.
            measured, time = self.link.measured(), float(command.path_time[-1])
            if measured is not None:
                time = trajectory.nearest(measured.position, command.path_time[0] - _OVERRUN, time + _OVERRUN)
            self._play(self._along(trajectory, PathState(time, 0.0), self._speed))
            self._lead_back()
        elif self.link.params.stop == "empty":
            return  # nobody knows what the driver is braking through
        else:
            index = self._next(command, dt, encoded=(trajectory.duration - float(command.path_time[-1])) / command.dt)
            if index is None:
                return
            self._play(self._along(trajectory, command.at(index), self._speed))
        self._braking = self._resuming = False

    def _repace(self, command: RetimedTrajectory, now: float, dt: float) -> None:
        """Have the rest played at the new path speed, from where the driver will be when it has it."""
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
        """The index of the point that comes next when the driver has what is sent in this tick; None if that is not known.

        A driver plays whole points, at times of its own. One that tells them has the time of a point from when it has told of one,
        and in the ticks (of `dt` s) in between it is not known. One that tells nothing began to play as long after it was sent
        something as it will now, so that it is a whole number of points on in a tick in which that many have gone by. So
        many points (`encoded`) that are encoded first come later.
        """
        encoding = _ENCODING * encoded / command.dt
        if self.link.params.state_topic is not None:
            return self._told + 1.0 + int(encoding) if self._gone_on else None
        if self._late(command):
            return self._playing(command) + int(encoding)
        due = self._clock + encoding - _ENCODING * len(command) / command.dt
        return float(round(due)) if abs(due - round(due)) * command.dt <= dt / 2 else None

    def _playing(self, command: RetimedTrajectory) -> float:
        """The index of the point that the driver plays when it learns of something.

        It is one beyond that which it told of. Where it tells nothing it is on time, unless the robot is further behind than
        a robot is: then the driver is slower than it was told, and `delay` beyond the robot.
        """
        if self.link.params.state_topic is not None:
            return self._index + 1.0
        return self._index + self.link.params.delay / command.dt if self._late(command) else self._clock + 1.0

    def _late(self, command: RetimedTrajectory) -> bool:
        """Whether a driver that tells nothing does not keep time: the robot is further behind than a robot is."""
        behind = (self._clock - self._index) * command.dt
        return self.link.params.state_topic is None and behind > self.link.params.delay + _ON_TIME

    def _along(self, trajectory: TimedTrajectory, state: PathState, target: float) -> Follower:
        time, speed, rate = state
        return Follower(trajectory, self.link.limits, time=time, speed=speed, rate=rate, target=target)

    def _transmit(self, now: float) -> None:
        if self._command is None:
            return
        # A robot that stands already must not begin to move in order to brake.
        empty = self._braking and (self.link.params.stop == "empty" or self.link.standing())
        self._sequence = self.link.stop() if empty else self.link.send(self._command.points)
        self._sent_at = now
        self.sent(now)
        self._unsent = False

    def _play(self, follower: Follower) -> None:
        self._command = follower.ahead(self.link.params.point_dt)
        self._index = self._clock = self._told = 0.0
        self._unsent = True
        self._repacing = self._repacing and follower.target != self._speed

    def _reached(self, command: RetimedTrajectory, dt: float) -> float:
        """The index of the point that the robot has reached."""
        if self._braking:
            return self._clock - self.link.params.delay / command.dt
        if self.link.params.state_topic is None:
            window = max(_WINDOW, dt) / command.dt
            return self._nearest(self._index - window, min(self._index + window, self._clock))
        return self._told

    def _ended_untold(self, command: RetimedTrajectory, now: float) -> bool:
        """Whether the robot rests at the end of its path, of which its driver has not told: progress may get lost.

        From the point that the driver told of last the path does not lead away from its end, so that the robot is not still to come
        back to it.
        """
        measured, execution = self.link.measured(), self.link.execution
        if measured is None or self._trajectory is None or self._braking or self._index == command.last:
            return False
        if self._told <= 0.0 or self._clock < command.last or now - self._told_at < _SILENT or not self.link.standing():
            return False
        end, left = self._trajectory.end, command.points.position[int(self._told) :]
        there = np.abs(measured.position - end) <= execution.goal_tolerance
        return bool(there.all() and np.all(np.abs(left - end) <= execution.path_tolerance))

    def _told_of(self, command: RetimedTrajectory) -> float:
        """The index of the point that the driver has told of last; 0 before it has told of any."""
        fraction = None if self._sequence is None else self.link.fraction(self._sequence)
        return 0.0 if fraction is None else fraction * len(command) - 1.0

    def _nearest(self, first: float, last: float) -> float:
        """The index, in this range, of the point nearest to the measured robot.

        Of points that are about as near, the last: a robot may rest a little beside the end, and a path may stand still.
        """
        measured, command = self.link.measured(), self._command
        if measured is None or command is None:
            return 0.0
        begin = max(int(first), 0)
        distance = np.abs(command.points.position[begin : int(max(last, 0.0)) + 1] - measured.position).max(axis=1)
        about = distance.min() + self.link.execution.goal_tolerance / 2
        return float(begin + np.flatnonzero(distance <= about)[-1])

    def _lead_back(self) -> None:
        """A robot that braked by itself stands beside the path: before the rest of the path comes the way back to it."""
        measured, command = self.link.measured(), self._command
        if measured is None or command is None:
            return
        limits = self.link.velocity_clamp, self.link.limits.acceleration, self.link.limits.jerk
        way = TimedTrajectory.standing(command.points.position[0]).approached_from(measured.position, *limits)
        times = np.arange(0.0, way.duration - 1.0, command.dt)  # without the second of rest
        held = np.zeros_like(times)
        states = np.concatenate((way.sample(times), command.points.states), axis=1)
        self._command = RetimedTrajectory(
            command.dt,
            np.concatenate((held + command.path_time[0], command.path_time)),
            np.concatenate((held, command.path_speed)),
            np.concatenate((held, command.path_rate)),
            TimedTrajectory(np.arange(float(states.shape[1])) * command.dt, *states),
        )
