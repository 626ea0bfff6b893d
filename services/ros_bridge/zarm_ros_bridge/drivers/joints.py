"""A driver's joint states in their DDS serialization."""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState as RosJointState

from zarm_contract.messages import JointState
from zarm_ros_bridge.convert.joints import driver_joint_state, places_of

_LITTLE_ENDIAN = b"\x00\x01"
"""Header of plain CDR in little-endian order (DDSI-RTPS 2.5, 10.2). Two bytes of options follow."""
_BODY = 4
"""Start of the message itself; numbers are aligned from here, each to its own size."""
_STAMP = struct.Struct("<iI")
_FRAME = _BODY + _STAMP.size
"""Start of the frame's name, which the names of the joints follow."""


class DriverJointStates:
    """Reads serialized messages of one driver: states of `joints`, and of `optional` ones where they are there; `unnamed` are those
    of a message without names, by index.

    rclpy takes 0.15 ms of CPU to build a Python message, mostly for what never changes: frame and names. These are read
    from the first message, and only the numbers from later ones, as long as all bytes before them are the same.
    """

    def __init__(self, unnamed: Sequence[str], joints: Sequence[str], optional: Sequence[str] = ()) -> None:
        self._unnamed = unnamed
        self._optional = optional
        self._joints = joints
        self._layout: _Layout | None = None

    def read(self, message: bytes) -> JointState:
        """The joint state. Raises InvalidRequest as `driver_joint_state` does."""
        state = None if self._layout is None else self._layout.read(message)
        if state is None:
            whole = deserialize_message(message, RosJointState)
            state = driver_joint_state(whole, self._unnamed, self._joints, self._optional)
            self._layout = _Layout.of(message, whole, state.joint_names, self._unnamed)
        return state


@dataclass(frozen=True, slots=True)
class _Layout:
    """The layout of a message, without its stamp and its numbers: the bytes up to the numbers, and the index of each of
    `joints` among them.

    DDS alignment padding is arbitrary: `mask` has a 0 there, and a 1 in each other bit of `names`.
    """

    begin: int
    mask: int
    names: int
    numbers: struct.Struct
    efforts: struct.Struct
    count: int
    joints: tuple[str, ...]
    places: tuple[int, ...]

    @classmethod
    def of(cls, message: bytes, read: RosJointState, joints: tuple[str, ...], unnamed: Sequence[str]) -> Self:
        """The layout of a message that was read."""
        mask, count = bytearray(), len(read.position)
        for size, alignment in (
            (_length(read.header.frame_id), 4),
            (4, 4),  # number of names
            *((_length(name), 4) for name in read.name),
            (4, 4),  # number of positions
            (0, 8),
        ):
            mask += bytes(-(_STAMP.size + len(mask)) % alignment) + b"\xff" * size
        begin, bits, places = _FRAME + len(mask), int.from_bytes(mask), places_of(read.name or unnamed, joints, "name")
        return cls(
            begin,
            bits,
            int.from_bytes(message[_FRAME:begin]) & bits,
            struct.Struct(f"<{count}dI4x{count}d"),
            struct.Struct(f"<I4x{count}d"),
            count,
            joints,
            tuple(places[joint] for joint in joints),
        )

    def read(self, message: bytes) -> JointState | None:
        """The joint state; None if the message has another layout, no stamp, or a number that is not finite."""
        begin, count = self.begin, self.count
        if message[:2] != _LITTLE_ENDIAN or len(message) < begin + self.numbers.size:
            return None
        numbers = self.numbers.unpack_from(message, begin)
        if int.from_bytes(message[_FRAME:begin]) & self.mask != self.names or numbers[count] != count:
            return None
        seconds, nanoseconds = _STAMP.unpack_from(message, _BODY)
        position = tuple([numbers[place] for place in self.places])
        velocity = tuple([numbers[count + 1 + place] for place in self.places])
        if not (seconds or nanoseconds) or not all(map(math.isfinite, position + velocity)):
            return None
        return JointState(
            stamp=seconds + nanoseconds * 1e-9,
            joint_names=self.joints,
            position=position,
            velocity=velocity,
            effort=self._effort(message),
        )

    def _effort(self, message: bytes) -> tuple[float, ...] | None:
        """The efforts; None unless there is a finite one for each joint."""
        begin = self.begin + self.numbers.size
        if len(message) < begin + self.efforts.size:
            return None
        count, *efforts = self.efforts.unpack_from(message, begin)
        chosen = tuple([efforts[place] for place in self.places])
        return chosen if count == self.count and all(map(math.isfinite, chosen)) else None


def _length(text: str) -> int:
    """Bytes of a string: its length, its text, and a zero."""
    return 4 + len(text.encode()) + 1
