"""The chunks of one session: checked one by one, and which of them counts when."""

from __future__ import annotations

import threading
from dataclasses import dataclass

import numpy as np

from zarm_contract.errors import InvalidRequest
from zarm_contract.messages import Clipped, JointPoints, ServoChunk
from zarm_geometry.robot_model import RobotModel
from zarm_servo.tracking.pose_points import joints_of
from zarm_servo.tracking.reference import Reference, clipped, smooth
from zarm_trajectory.arrays import Array
from zarm_trajectory.limits import Limits
from zarm_trajectory.trajectory import TimedTrajectory
from zarm_trajectory.turns import whole_turns

EARLY, LATE = 0.02, 1.0
"""A chunk was made at most so long (s) after, and before, the servo's present: else the clocks differ, or it has lost its way."""
SOON = 10.0
"""A chunk starts at most so long (s) after it was made."""
JUMP = 0.5
"""A chunk begins at most this far (rad) from where the chunk before, or the robot, would be."""
MAX_CHUNK_DURATION = 60.0
"""Longest chunk (s)."""
LARGEST = 1000.0
"""A larger number (rad, rad/s) is in another unit, or the result of a division by zero."""
_CLOSEST = 0.001
"""Least time (s) between two points."""


@dataclass(frozen=True)
class Taken:
    """What the answer to a chunk tells of it, see `ChunkAccepted`."""

    late: float
    lost: int
    jump: float
    clipped: tuple[Clipped, ...]
    observation_age: float | None


class ChunkInbox:
    """Receives the chunks for a robot with these limits. `now` is on the monotonic clock, `unix` the same moment on the other. Thread-safe."""

    def __init__(self, model: RobotModel, limits: Limits) -> None:
        self._model, self._limits = model, limits
        self._lock = threading.Lock()
        self._references: tuple[Reference, ...] = ()
        self._sequence = 0

    @property
    def sequence(self) -> int:
        """The number of the newest chunk, 0 before the first."""
        return self._sequence

    def at(self, time: float) -> Reference | None:
        """What is to be followed at a `time` (s): the newest chunk that has begun, unless it has expired."""
        for reference in reversed(self._references):
            if reference.begins <= time:
                return reference if time <= reference.expires else None
        return None

    def receive(self, message: ServoChunk, now: float, unix: float, time: float, position: Array) -> Taken:
        """Take a chunk. The robot, next commanded for `time` (s), will then be at `position` (J,).

        Raises InvalidRequest, which names the field, for a chunk that is not the next one, or is on another clock, or has ended, or
        that this robot cannot follow.
        """
        with self._lock:
            if message.sequence <= self._sequence:
                raise InvalidRequest(
                    f"chunk {message.sequence} came after chunk {self._sequence}; number them upwards from 1",
                    field="sequence",
                )
            start = self._start(message, unix) - unix + now
            times = start + _times(message)
            expires = float(times[-1])
            if message.expiry is not None:
                expires = min(expires, start + message.expiry)
            if expires <= time:
                raise InvalidRequest(
                    f"chunk {message.sequence} ended {time - expires:.3f} s before the robot could follow it; "
                    "send it earlier, or make it longer",
                    field="start",
                )
            asked = self._motion(message, times, position)
            reference = Reference(asked, expires, message.gripper, self._openings(message, len(times)))
            jump = self._jump(reference, max(start, time), position)
            lost = message.sequence - self._sequence - 1 if self._sequence else 0
            self._sequence = message.sequence
            current = self.at(time)
            kept = (each for each in self._references if each is current or each.begins > time)
            self._references = (*(each for each in kept if each.begins < start), reference)
        age = None if message.observed is None else unix - message.observed
        return Taken(max(0.0, now - start), lost, jump, clipped(asked, self._limits), age)

    def _start(self, message: ServoChunk, unix: float) -> float:
        """When a chunk starts (Unix, s)."""
        made = unix - message.stamp
        if not -EARLY <= made <= LATE:
            side = f"{-made:.3f} s in the future" if made < 0 else f"{made:.3f} s ago"
            raise InvalidRequest(
                f"the chunk was made {side} by the servo's clock (at most {EARLY:g} s and {LATE:g} s); set the clocks of both computers by NTP, "
                "and send a chunk as soon as it is made",
                field="stamp",
            )
        start = message.stamp if message.start is None else message.start
        if start - message.stamp > SOON:
            raise InvalidRequest(
                f"the chunk starts {start - message.stamp:.1f} s after it was made (at most {SOON:g} s); it is a Unix time in s",
                field="start",
            )
        return start

    def _motion(self, message: ServoChunk, times: Array, position: Array) -> TimedTrajectory:
        """The motion that a chunk asks for, continuous joints as near to `position` (J,) as they can be."""
        points = message.points
        if not isinstance(points, JointPoints):
            self._demand_length(points.pose, len(times), "points.pose")
            self._model.robot.check_tip(points.group, "points.group")
            return smooth(times, joints_of(self._model, points.pose, points.group, position))
        rows = self._rows(points.position, len(times), "points.position")
        rows -= whole_turns(rows[0] - position, self._model.continuous)
        speeds = None if points.velocity is None else self._rows(points.velocity, len(times), "points.velocity")
        return smooth(times, rows, speeds)

    def _rows(self, rows: tuple[tuple[float, ...], ...], count: int, field: str) -> Array:
        self._demand_length(rows, count, field)
        for index, row in enumerate(rows):
            if len(row) != self._model.dof:
                raise InvalidRequest(
                    f"{len(row)} values, and this robot has {self._model.dof} joints", field=f"{field}[{index}]"
                )
            if max(map(abs, row)) > LARGEST:
                raise InvalidRequest(
                    f"{max(row, key=abs):g} is more than {LARGEST:g}; positions are in rad, velocities in rad/s",
                    field=f"{field}[{index}]",
                )
        return np.array(rows)

    def _jump(self, reference: Reference, begins: float, position: Array) -> float:
        """How far (rad) it is from where the robot would be to the beginning of a chunk."""
        there = reference.sample(np.array([begins]))[0, 0]
        before = self.at(begins)
        away = [np.abs(there - position)]
        if before is not None:
            away.append(np.abs(there - before.sample(np.array([begins]))[0, 0]))
        jump = min(away, key=lambda each: float(each.max()))
        worst = int(jump.argmax())
        if jump[worst] > JUMP:
            raise InvalidRequest(
                f"{self._limits.joints[worst]} would jump by {jump[worst]:.2f} rad (at most {JUMP:g}) to the chunk, which begins elsewhere; "
                "plan and execute a motion to its beginning first",
                field="points",
            )
        return float(jump[worst])

    def _openings(self, message: ServoChunk, count: int) -> Array:
        """The openings (N,) of the gripper."""
        if (message.opening is None) != (message.gripper is None):
            missing = "gripper" if message.gripper is None else "opening"
            raise InvalidRequest("`gripper` and `opening` go together", field=missing)
        if message.opening is None or message.gripper is None:
            return np.zeros(0)
        grippers = self._model.robot.descriptor.grippers
        gripper = grippers.get(message.gripper)
        if gripper is None:
            known = ", ".join(grippers) or "no gripper"
            raise InvalidRequest(f"this robot has {known}, not {message.gripper}", field="gripper")
        self._demand_length(message.opening, count, "opening")
        for index, opening in enumerate(message.opening):
            if not gripper.closed <= opening <= gripper.open:
                raise InvalidRequest(
                    f"{opening:g} m; {message.gripper} opens from {gripper.closed:g} to {gripper.open:g} m",
                    field=f"opening[{index}]",
                )
        return np.array(message.opening)

    @staticmethod
    def _demand_length(rows: tuple[object, ...], count: int, field: str) -> None:
        if len(rows) != count:
            raise InvalidRequest(
                f"{len(rows)} entries, and the chunk has {count} points; give one for each", field=field
            )


def _times(message: ServoChunk) -> Array:
    """The times (N,) of the points, s after the start."""
    points = message.points
    times: Array
    if (message.dt is None) == (message.time is None):
        raise InvalidRequest("give either `dt` or `time`", field="dt")
    if message.time is None:
        count = len(points.position) if isinstance(points, JointPoints) else len(points.pose)
        times, field = (message.dt or 0.0) * np.arange(float(count)), "dt"
    else:
        times, field = np.array(message.time), "time"
    if np.diff(times).min() < _CLOSEST:
        raise InvalidRequest(f"points follow each other by {_CLOSEST:g} s at least", field=field)
    if times[-1] > MAX_CHUNK_DURATION:
        raise InvalidRequest(
            f"the chunk lasts {times[-1]:.3g} s (at most {MAX_CHUNK_DURATION:g} s); send less at once", field=field
        )
    return times
