"""Transforms between frames over time, as published on /tf and /tf_static."""

from __future__ import annotations

import threading
from bisect import bisect_left
from collections import deque

import numpy as np

from zarm_contract.errors import InvalidRequest
from zarm_contract.messages import Pose
from zarm_geometry.frames import matrix
from zarm_trajectory.arrays import Array

HISTORY = 10.0
"""How long (s) transforms are kept, as in tf2."""
MAX_EXTRAPOLATION = 0.2
"""How far (s) a time may be after the last transform of a frame, which then counts: publishers are late."""


class UnknownFrame(InvalidRequest):
    """A frame cannot be transformed: nobody publishes it, or not at that time."""


class Transforms:
    """A tree of frames: each has one parent, and its pose there at several times. Thread-safe."""

    def __init__(self) -> None:
        self._turn = threading.Lock()
        self._frames: dict[str, _Frame] = {}

    def put(self, parent: str, child: str, stamp: float | None, pose: Pose) -> None:
        """The `pose` of `child` in the frame `parent` at `stamp` (s); None: at all times."""
        with self._turn:
            frame = self._frames.get(child)
            if frame is None or frame.parent != parent or (stamp is None) != (frame.fixed is not None):
                frame = self._frames[child] = _Frame(parent)
            frame.put(stamp, pose)

    def parent(self, frame: str) -> str | None:
        """The frame in which this one is published, None if it is not."""
        with self._turn:
            found = self._frames.get(frame)
            return None if found is None else found.parent

    def names(self) -> set[str]:
        """All frames that are published, or that others are published in."""
        with self._turn:
            return set(self._frames) | {frame.parent for frame in self._frames.values()}

    def in_parent(self, frame: str, stamp: float) -> Array:
        """The pose (4, 4) of a frame in its parent at `stamp` (s; 0: the last one). Raises UnknownFrame for another time."""
        with self._turn:
            return self._frames[frame].at(stamp, frame)


class _Frame:
    """A frame in its parent: `fixed`, or at the times of `poses`."""

    def __init__(self, parent: str) -> None:
        self.parent = parent
        self.fixed: Array | None = None
        self._stamps: deque[float] = deque()
        self._poses: deque[Pose] = deque()

    def put(self, stamp: float | None, pose: Pose) -> None:
        if stamp is None:
            self.fixed = matrix(pose.position, pose.orientation)
            return
        if self._stamps and stamp < self._stamps[-1] - HISTORY:  # a clock was set back
            self._stamps.clear()
            self._poses.clear()
        at = len(self._stamps) if not self._stamps or stamp > self._stamps[-1] else bisect_left(self._stamps, stamp)
        self._stamps.insert(at, stamp)
        self._poses.insert(at, pose)
        while self._stamps[0] < self._stamps[-1] - HISTORY:
            self._stamps.popleft()
            self._poses.popleft()

    def at(self, stamp: float, name: str) -> Array:
        if self.fixed is not None:
            return self.fixed
        first, last = self._stamps[0], self._stamps[-1]
        if not first - 1e-9 <= (stamp or last) <= last + MAX_EXTRAPOLATION:
            raise UnknownFrame(
                f"the frame {name} is known from {first:.3f} to {last:.3f}, and not at {stamp:.3f}; give a stamp of that "
                "time, or 0 for the last pose",
                field="header.stamp",
            )
        after = bisect_left(self._stamps, stamp or last)
        if after in (0, len(self._stamps)):
            pose = self._poses[min(after, len(self._poses) - 1)]
            return matrix(pose.position, pose.orientation)
        span = self._stamps[after] - self._stamps[after - 1]
        return between(
            self._poses[after - 1], self._poses[after], ((stamp or last) - self._stamps[after - 1]) / (span or 1.0)
        )


def between(start: Pose, end: Pose, share: float) -> Array:
    """The pose (4, 4) at `share` (0..1) of the way between two: straight, and about one axis (slerp)."""
    p, q = np.array(start.orientation), np.array(end.orientation)
    cosine = float(p @ q)
    if cosine < 0.0:
        q, cosine = -q, -cosine
    angle = np.arccos(min(cosine, 1.0))
    if angle < 1e-6:
        turned = (1.0 - share) * p + share * q
    else:
        turned = (np.sin((1.0 - share) * angle) * p + np.sin(share * angle) * q) / np.sin(angle)
    x, y, z, w = (turned / np.linalg.norm(turned)).tolist()
    px, py, pz = ((1.0 - share) * np.array(start.position) + share * np.array(end.position)).tolist()
    return matrix((px, py, pz), (x, y, z, w))
