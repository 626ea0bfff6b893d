"""Streams short chunks of points to the driver: the common part of `joint_speed` and `joint_pose`.

Every chunk holds the motion from now on and replaces the rest of the previous one. It extends beyond the next chunk, so
that a late chunk does no harm, and ends with braking along the path, so that without further chunks the driver brings
the robot to rest on the path by itself.
"""

from __future__ import annotations

import copy
from abc import abstractmethod

import numpy as np

from zarm_executor.strategies.base import Progress, Steerable
from zarm_executor.strategies.driver import DriverStrategy
from zarm_executor.strategies.reference import Commanded, Reference
from zarm_executor.strategies.robot_link import RobotLink
from zarm_trajectory.follower import CATCH_UP, TICK, Follower
from zarm_trajectory.path_state import PathState
from zarm_trajectory.retimed import RetimedTrajectory
from zarm_trajectory.trajectory import TimedTrajectory

_BEHIND = 1.0
"""How far (s of path time) behind the command a standing robot is searched for."""
_ON_CHUNK = 0.05
"""A robot within this distance (rad) of where its driver should have brought it is playing the last chunk."""
_SLOPE = 1e-6
"""Squared speed of a path, (rad/s)^2, below which a robot's path speed cannot be derived from its velocity."""
_OFF_GRID = 0.3
"""An urgent chunk is sent when the driver is within this share of a point of beginning the next one."""
_ROUNDING = 1e-6
"""Tolerance (s) when comparing ticks with a moment."""


class Streaming(DriverStrategy, Steerable):
    """Sends chunks from the start of a motion until the robot rests, then nothing.

    The robot is expected to be `delay` behind the command; `progress` reports its expected place.
    """

    def __init__(self, link: RobotLink) -> None:
        super().__init__(link)
        self._dt, self._period, look_ahead, self._delay = link.timing
        self._count = round((self._period + look_ahead) / self._dt)
        self._follower: Follower | None = None
        self._memory = self._delay + self.link.execution.joint_state_timeout + CATCH_UP
        self._reference = Reference(self._memory)
        self._expected: Commanded | None = None
        self._sent_at: float | None = None
        self._wanted = 0.0
        self._urgent = False
        self._over = True
        self._away: tuple[float, float] | None = None
        self._lost_at: float | None = None
        self._chunk: RetimedTrajectory | None = None
        self._played_at = -np.inf

    # -- implemented by each streaming strategy --

    @abstractmethod
    def _send(self, ahead: RetimedTrajectory, now: float, played: int) -> bool:
        """Send a chunk, `played` points into the previous one; returns whether all of it is at rest."""

    def _arrived(self) -> bool:
        """Whether the robot has arrived at the end of the path, as far as this strategy can influence that."""
        return True

    def _stands(self) -> None:
        """The robot stands, whatever was sent."""

    def _forget_sent(self) -> None:
        """What the driver plays is no longer known."""

    # -- called by the state machine --

    def start(self, trajectory: TimedTrajectory, speed: float) -> None:
        """Begin at the start of `trajectory`."""
        self.link.begin()
        begin = trajectory.begin
        self._follower = Follower(trajectory, self.link.limits, time=begin, speed=speed, target=speed)
        self._reference = Reference(self._memory)
        self._expected = Commanded(0.0, begin, 0.0, trajectory.start)
        self._sent_at, self._over, self._away, self._lost_at, self._chunk = None, False, None, None, None
        self._wanted = speed

    def stop(self) -> None:
        """Let the path speed fall to 0."""
        self._aim(0.0)

    def move(self, speed: float) -> None:
        """Let the path speed become `speed`."""
        self._aim(speed)
        self._over = self._follower is None

    def _aim(self, speed: float) -> None:
        if self._follower is not None and self._wanted != speed:
            self._wanted, self._urgent = speed, True

    def commanded(self) -> float:
        """The commanded path time (s); the robot is `delay` behind it."""
        return 0.0 if self._follower is None else self._follower.time

    def steer(self, trajectory: TimedTrajectory) -> None:
        """Continue along `trajectory` with the next chunk, which is sent early."""
        if self._follower is not None:
            self._follower.join(trajectory)
            self._urgent, self._over = True, False

    def tick(self, now: float, dt: float) -> None:
        """Advance, and send a chunk if one is due."""
        self.look()
        follower = self._follower
        if follower is None:
            return
        if self._over:
            if self._wanted == 0.0:
                self.hold(now)
            return
        if self._sent_at is not None and dt > CATCH_UP:
            self._away = now, dt
        if self._away is not None and self._unheard(now, self._away[0]):
            return
        if not self.link.is_reporting(now):
            self._brake_unheard(follower, now, dt)
            return
        if self._lost_at is not None:
            self._rest_where_found(follower, now)
            return
        if self._sent_at is None:
            # A rest at the beginning counts from the start of the motion; what moves begins with the first chunk.
            _, *moves = follower.trajectory.at(follower.time + dt)
            if not np.any(moves):
                follower.advance(min(dt, CATCH_UP))
        else:
            if self._away is not None:
                pause, self._away = self._away[1], None
                follower = self._picked_up(follower, now, pause)
            else:
                follower.advance(dt)
            if self._wanted == 0.0 and not follower.settled and self.link.standing():
                follower = self._stopped_follower(follower)
        self._reference.note(now, follower)
        self._expected = self._reference.at(now - self._delay)
        begin = self._begin(now)
        if begin is not None:
            played = 0 if self._sent_at is None else round((begin - self._sent_at) / self._dt)
            ahead = self._ahead(follower, begin - now)
            self._chunk, self._played_at = ahead, begin + len(ahead) * self._dt
            follower.target = self._wanted
            rests = self._send(ahead, now, played)
            self._sent_at, self._urgent = begin, False
            self.sent(now)
            self._over = rests and follower.settled and self._caught_up() and self._may_end()

    def braking_from(self) -> PathState:
        """The command at the driver's next point, where an urgent chunk begins."""
        follower = self._follower
        return PathState(0.0, 0.0) if follower is None else follower.state.after(self._dt)

    def progress(self) -> Progress:
        """Where the robot should be by now."""
        follower, expected = self._follower, self._expected
        if follower is None or expected is None:
            return Progress(time=0.0, speed=0.0, command=np.zeros(len(self.link.joints)), finished=True)
        return Progress(expected.time, expected.speed, expected.position, follower.finished and self._over)

    def _unheard(self, now: float, back_at: float) -> bool:
        """Whether the driver's messages from a pause are still unread; until they are read, it brakes the robot by
        itself.
        """
        measured, patience = self.link.measured(), self.link.execution.joint_state_timeout
        return (measured is None or now - measured.time > patience) and now - back_at <= patience

    def _brake_unheard(self, follower: Follower, now: float, dt: float) -> None:
        """The driver is not heard: it brakes the robot with the chunk that it has, and the command follows that."""
        self._away = None
        if self._lost_at is None:
            self._lost_at = now
        follower.target = 0.0
        follower.advance(min(dt, CATCH_UP))
        self._reference.note(now, follower)
        self._expected = self._reference.at(now - self._delay)
        self._hold_once_played(now)

    def _hold_once_played(self, now: float) -> None:
        """Make the driver stop the robot by its own means if the last chunk has not brought it to rest."""
        if now > self._played_at:
            self.hold(now)

    def _rest_where_found(self, follower: Follower, now: float) -> None:
        """The driver is heard again after braking the robot with the chunk that it had: hold the motion where the robot
        stands.

        A motion that was not told to stop continues from there.
        """
        self._hold_once_played(now)
        standing = self.link.standing()
        follower = self._stopped_follower(follower, ahead=now - (self._sent_at or now))
        self._expected = Commanded(now, follower.time, 0.0 if standing else 1.0, follower.position)
        if standing:
            self._lost_at, self._over = None, self._wanted == 0.0
            self._reference = Reference(self._memory)
            self._reference.note(now, follower)

    def _picked_up(self, follower: Follower, now: float, dt: float) -> Follower:
        """After a pause in which nothing was sent: continue from where the driver is in the chunk that it has.

        A robot that is elsewhere has not received it: then continue from its present position and speed.
        """
        self._reference = Reference(self._memory)
        if self._chunk is not None and self._sent_at is not None:
            index = (now - self._sent_at) / self._dt
            before = index - self._delay / self._dt
            expected = self._chunk.position(before)
            measured = self.link.measured()
            if measured is not None and np.all(np.abs(measured.position - expected) <= _ON_CHUNK):
                self._reference.note(now - self._delay, follower.moved_to(self._chunk.at(before), self._wanted))
                self._follower = follower.moved_to(self._chunk.at(index), self._wanted)
                return self._follower
        self._forget_sent()
        self._follower = self._found(follower, now, dt)
        return self._follower

    def _found(self, follower: Follower, now: float, dt: float) -> Follower:
        """The motion at the command that belongs to the robot's measured position, `delay` ahead of it."""
        measured, trajectory = self.link.measured(), follower.trajectory
        if measured is None:
            return follower
        time = trajectory.nearest(measured.position, follower.time - _BEHIND, follower.time + dt)
        slope = trajectory.at(time)[1]
        length = float(slope @ slope)
        speed = min(max(float(slope @ self.link.velocity()) / length, 0.0), 1.0) if length > _SLOPE else 0.0
        follower = follower.moved_to(PathState(time, speed), self._wanted)
        self._reference.note(now - self._delay, follower)
        for _ in range(round(self._delay / TICK)):
            follower.advance(TICK)
        return follower

    def _stopped_follower(self, follower: Follower, ahead: float = 0.0) -> Follower:
        """A robot at rest must not start to move in order to brake: hold the motion where the robot stands.

        The robot may be up to `ahead` s of path time beyond the motion.
        """
        measured, time = self.link.measured(), follower.time
        if measured is not None:
            time = follower.trajectory.nearest(measured.position, time - _BEHIND, time + ahead)
        self._follower = follower.moved_to(PathState(time, 0.0), 0.0)
        self._stands()
        return self._follower

    def _begin(self, now: float) -> float | None:
        """The moment at which the chunk to be sent now begins; None if none is due.

        Chunks begin `chunk_period` apart, which need not be a whole number of ticks: each is sent by the last tick
        before it begins.
        """
        if self._sent_at is None:
            return now
        due = self._sent_at + self._period
        if due - now < self.link.execution.control_period - _ROUNDING:
            return max(due, now)
        points = (now - self._sent_at) / self._dt
        urgent = self._urgent and round(points) > 0 and abs(points - round(points)) < _OFF_GRID
        return now if urgent else None

    def _ahead(self, follower: Follower, seconds: float) -> RetimedTrajectory:
        """The points of a chunk that begins in `seconds`; until then the driver plays what it has."""
        scout = copy.copy(follower)
        scout.advance(seconds)
        scout.target = self._wanted
        ahead = scout.ahead(self._dt, self._count)
        return ahead.followed_by(scout.moved_to(ahead.at(ahead.last), 0.0).ahead(self._dt))

    def _caught_up(self) -> bool:
        """Whether the robot has had time to come to rest too."""
        expected, follower = self._expected, self._follower
        return (
            expected is not None and follower is not None and expected.time == follower.time and expected.speed == 0.0
        )

    def _may_end(self) -> bool:
        return self._wanted == 0.0 or self._arrived()
