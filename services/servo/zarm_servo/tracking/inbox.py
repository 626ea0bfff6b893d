"""The live target of a session: the newest one, its age, and why others were refused."""

from __future__ import annotations

import threading
from dataclasses import replace

import numpy as np

from zarm_contract import messages as m
from zarm_contract.errors import InvalidRequest, Problem, ZarmError
from zarm_contract.robot import RobotDescription
from zarm_geometry.frames import matrix
from zarm_servo.refusal import Refusal
from zarm_servo.tracking.controller import STALE
from zarm_servo.tracking.joint_stream import JointStream
from zarm_servo.tracking.targets import JointSpeedTarget, JointTarget, PoseTarget, Target, TwistTarget
from zarm_trajectory.arrays import Array

_DRIFT = 1e-3
"""Two clocks drift by less than this (s per s): NTP slews by 0.5e-3 at most."""
_JUMP = 2.0, 6.0
"""A pose that moves faster than this (m/s, rad/s) from one target to the next has jumped."""
_SKIPPED = 1000
"""At most one second's targets are lost between two that arrive; if more are missing, the number is wrong."""
_CLOCK_JUMP = 1.0
"""A stamp further ahead (s) than the time since the previous target comes from a clock that is wrong or was set."""
_REORDERED = 1.0
"""Targets that arrive out of order do so within this time (s)."""
_LARGEST_VALUE = 1000.0
"""A larger number (m, rad, m/s, rad/s) is not a valid target: it is in another unit, or the result of a division by
zero.
"""


class Inbox:
    """Receives the targets of one session of a robot. `now` is on the monotonic clock. Thread-safe."""

    def __init__(self, robot: RobotDescription) -> None:
        self._robot = robot
        self._joints = len(robot.descriptor.joints)
        self._lock = threading.Lock()
        self._target: Target | None = None
        self._message: m.ServoTarget | None = None
        self._arrived = self._under_way = 0.0
        self._least: float | None = None
        self._odd: tuple[m.ServoTarget, float] | None = None  # refused last for its number or stamp, and when it came
        self._stream = JointStream(robot)
        self._refusal = Refusal()

    @property
    def refused(self) -> Problem | None:
        """Why a target was refused."""
        return self._refusal.problem

    @property
    def sequence(self) -> int:
        """The sequence number of the newest target, 0 before the first."""
        return 0 if self._message is None else self._message.sequence

    def newest(self, now: float) -> tuple[Target | None, float | None]:
        """The newest target and its age (s); None before the first."""
        with self._lock:
            if self._target is None:
                return None, None
            return self._target, now - self._arrived + self._under_way

    def receive(self, message: m.ServoTarget, now: float) -> None:
        """Take a target, unless it is refused."""
        with self._lock:
            try:
                self._take(message, now)
            except ZarmError as error:
                self.refuse(error.problem, now)
            else:
                self._refusal.taken(now)

    def refuse(self, problem: Problem, now: float) -> None:
        """Record why a message was refused as a target."""
        self._refusal.refused(problem, now)

    def _take(self, message: m.ServoTarget, now: float) -> None:
        before = self._message
        self._demand_order(message, now)
        offset = now - message.stamp
        least = offset if self._least is None else min(self._least + _DRIFT * (now - self._arrived), offset)
        under_way = offset - least
        if under_way > STALE:
            raise InvalidRequest(
                f"target {message.sequence} came {under_way:.3f} s later than others that were made before it (at most "
                f"{STALE:g} s); find out what delays it, or start a new session where the clock of the client was set back",
                field="stamp",
            )
        target = self._read(message)
        passed = None if before is None or self._least is None else message.stamp - before.stamp
        reported = message.target
        if (
            isinstance(target, PoseTarget)
            and isinstance(reported, m.PoseTarget)
            and reported.linear is reported.angular is None
        ):
            target = _moving(self._target, target, passed)
        if isinstance(target, JointTarget) and isinstance(reported, m.JointTarget) and reported.velocity is None:
            target = self._stream.moving(message.stamp, target.position)
        else:
            self._stream.clear()
        self._message, self._target, self._least = message, target, least
        self._arrived, self._under_way = now, under_way
        self._odd = None

    def _demand_order(self, message: m.ServoTarget, now: float) -> None:
        """Refuse a target that does not follow the newest one.

        One that was overtaken is refused for good. Any other has a wrong number or stamp, or the client numbers its targets anew, or its
        clock was set: the next target shows which, as it follows the newest one or that one. Then the clock is learnt anew.
        """
        before, odd = self._message, self._odd
        if before is None:
            return
        fault = _fault(message, before, now - self._arrived)
        if fault is None:
            return
        overtaken = message.sequence <= before.sequence and message.stamp <= before.stamp
        if overtaken and now - self._arrived <= _REORDERED:
            raise fault
        self._odd = message, now
        if odd is None or _fault(message, odd[0], now - odd[1]) is not None:
            raise fault
        self._least = None

    def _read(self, message: m.ServoTarget) -> Target:
        for field, values in message.target:
            if isinstance(values, tuple) and max(map(abs, values), default=0.0) > _LARGEST_VALUE:
                raise InvalidRequest(
                    f"{max(values, key=abs):g} is more than {_LARGEST_VALUE:g}; lengths are in m, angles in rad, speeds in m/s and rad/s",
                    field=f"target.{field}",
                )
        match message.target:
            case m.PoseTarget() as reported:
                still = (0.0, 0.0, 0.0)
                velocity = np.array((*(reported.linear or still), *(reported.angular or still)))
                self._robot.check_tip(reported.group, "target.group")
                pose = matrix(reported.position, reported.orientation)
                return PoseTarget(pose, velocity, reported.tolerance, reported.group)
            case m.TwistTarget() as reported:
                self._robot.check_tip(reported.group, "target.group")
                twist = np.array((*reported.linear, *reported.angular))
                return TwistTarget(twist, reported.frame, reported.group)
            case m.JointSpeedTarget() as reported:
                return JointSpeedTarget(self._of_joints(reported.velocity, "target.velocity"))
            case m.JointTarget() as reported:
                position = self._of_joints(reported.position, "target.position")
                if reported.velocity is None:
                    return JointTarget(position, np.zeros_like(position))
                return JointTarget(position, self._of_joints(reported.velocity, "target.velocity"))

    def _of_joints(self, values: tuple[float, ...], field: str) -> Array:
        if len(values) != self._joints:
            raise InvalidRequest(f"{len(values)} values, and this robot has {self._joints} joints", field=field)
        return np.array(values)


def _fault(message: m.ServoTarget, before: m.ServoTarget, passed: float) -> InvalidRequest | None:
    """Why a target cannot have been made after another one that came `passed` s before it, if it cannot."""
    if message.sequence <= before.sequence:
        return InvalidRequest(
            f"target {message.sequence} came after target {before.sequence}; number them upwards from 1",
            field="sequence",
        )
    if message.sequence - before.sequence > _SKIPPED:
        return InvalidRequest(
            f"target {message.sequence} came next after target {before.sequence}, more than {_SKIPPED} before it; number them one by one",
            field="sequence",
        )
    ahead = message.stamp - before.stamp
    if ahead <= 0.0:
        return InvalidRequest(
            f"target {message.sequence} was made {-ahead:.3f} s before target {before.sequence}; "
            "do not set the clock of the client while a session is open",
            field="stamp",
        )
    if ahead - passed > _CLOCK_JUMP:
        return InvalidRequest(
            f"target {message.sequence} was made {ahead:.3f} s after target {before.sequence}, but came {passed:.3f} s after it; "
            "stamp all targets of a session on one clock (s)",
            field="stamp",
        )
    return None


def _moving(before: Target | None, target: PoseTarget, passed: float | None) -> PoseTarget:
    """A pose that goes on as it did from the target before, unless it has jumped."""
    if passed is None or passed > STALE or not isinstance(before, PoseTarget):
        return target
    if before.group != target.group:
        return target
    moving = target.moving(before.pose, passed)
    speeds = np.linalg.norm(moving.velocity[:3]), np.linalg.norm(moving.velocity[3:])
    return target if speeds[0] > _JUMP[0] or speeds[1] > _JUMP[1] else moving


def ahead(target: Target, seconds: float) -> Target:
    """The target `seconds` later."""
    if isinstance(target, PoseTarget):
        return replace(target, pose=target.after(seconds))
    if isinstance(target, JointTarget):
        return target.after(seconds)
    return target
