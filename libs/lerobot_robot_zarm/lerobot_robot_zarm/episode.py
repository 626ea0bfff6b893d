"""A record as an episode: what a policy would have observed, at a fixed rate."""

from __future__ import annotations

import fnmatch
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from zarm.record_story import robot_of
from zarm_contract.codec import decode
from zarm_contract.errors import InvalidRequest
from zarm_contract.keys import Keys
from zarm_contract.messages import GripperState, JointState
from zarm_runtime.record import read_record
from zarm_runtime.recorded_image import color_of

_SECOND = 1_000_000_000
_LONGEST_GAP = _SECOND
"""Longest time (ns) without joints, or without an image of a camera."""


@dataclass(frozen=True)
class Frame:
    """Positions by name (rad of the joints, m of the grippers), and images (h, w, 3) by camera."""

    positions: Mapping[str, float]
    images: Mapping[str, NDArray[np.uint8]]


class Episode:
    """The record `file` in frames, `fps` a second. Raises InvalidRequest for a file that is not a record, or that has no joints."""

    def __init__(self, file: Path, fps: int) -> None:
        self.file = file
        self._fps = fps
        keys = {key for _, key, _ in read_record(file)}
        if not keys:
            raise InvalidRequest(f"{file} is empty", field="file")
        self._keys = Keys(robot_of(min(keys)))
        self._grippers = sorted(fnmatch.filter(keys, self._keys.gripper_state("*")))
        self._cameras = sorted(fnmatch.filter(keys, self._keys.color("*")))
        if self._keys.joint_states not in keys:
            raise InvalidRequest(f"{file} has no joints of {self._keys.robot}", field="file")

    @cached_property
    def first(self) -> Frame:
        """Its first frame. Raises InvalidRequest if there is none."""
        for frame in self.frames():
            return frame
        raise InvalidRequest(f"{self.file} is too short for one frame", field="file")

    def frames(self) -> Iterator[Frame]:
        """Its frames: each has what was newest at its time. The first is there once every joint, gripper and camera of the record has been seen.

        Raises InvalidRequest where the joints or the images of a camera are missing for more than a second.
        """
        newest: dict[str, bytes] = {}
        came: dict[str, int] = {}
        needed = {self._keys.joint_states, *self._grippers, *self._cameras}
        lasting = {self._keys.joint_states, *self._cameras}
        begun, count = 0, 0
        for stamp, key, payload in read_record(self.file):
            while begun and stamp >= (due := begun + count * _SECOND // self._fps):
                for source in lasting:
                    if due - came[source] > _LONGEST_GAP:
                        raise InvalidRequest(
                            f"{self.file} has no {source} for more than a second, {(due - begun) / _SECOND:.1f} s after its first frame; leave this record out",
                            field="file",
                        )
                yield self._frame(newest)
                count += 1
            if key in needed:
                newest[key], came[key] = payload, stamp
                if not begun and newest.keys() == needed:
                    begun = stamp

    def _frame(self, newest: Mapping[str, bytes]) -> Frame:
        joints = decode(JointState, newest[self._keys.joint_states])
        positions = dict(zip(joints.joint_names, joints.position, strict=True))
        for key in self._grippers:
            gripper = decode(GripperState, newest[key])
            positions[gripper.gripper] = gripper.width or 0.0
        images = {key.rpartition("/")[2]: _image(newest[key]) for key in self._cameras}
        return Frame(positions, images)


def _image(message: bytes) -> NDArray[np.uint8]:
    header, pixels = color_of(message)
    image = np.frombuffer(pixels, np.uint8).reshape((header.height, header.width, -1))
    return np.broadcast_to(image, (header.height, header.width, 3))
