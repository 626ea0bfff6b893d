"""Plays a record instead of the live bus: its state at any moment."""

from __future__ import annotations

import time
from bisect import bisect
from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np

from zarm.record_story import Story, summarize
from zarm_contract.codec import decode
from zarm_contract.errors import InvalidRequest
from zarm_contract.keys import Keys
from zarm_contract.messages import GoalState, GripperState, JointState, Message, PerceptionState, VoxelBlock
from zarm_geometry.voxel_blocks import VoxelBlocks
from zarm_runtime.record import read_record
from zarm_runtime.recorded import Recorded
from zarm_trajectory.arrays import Array
from zarm_viewer.watching import News, in_order, tracking_error

SPEEDS = (0.1, 0.25, 0.5, 1.0, 2.0, 4.0)
"""Playback speeds relative to real time."""


class Playback:
    """A record of `zarm record` or of a flight recorder. Raises InvalidRequest if the file is not a record.

    It plays once from beginning to end. Messages are decoded only when needed.
    """

    def __init__(self, file: Path) -> None:
        entries = list(read_record(file))
        self.file = file
        self.story: Story = summarize(entries)
        self.speed = 1.0
        self._keys = Keys(self.story.robot)
        self._recorded = Recorded(self._keys, scene=True)
        self._times: dict[str, list[float]] = defaultdict(list)
        self._payloads: dict[str, list[bytes]] = defaultdict(list)
        for stamp, key, payload in entries:
            self._times[key].append((stamp - self.story.began) / 1e9)
            self._payloads[key].append(payload)
        self._at, self._since = 0.0, time.monotonic()
        self._playing = True
        self._reported: dict[str, int] = {}
        self._voxels = VoxelBlocks()
        self._shown = self._voxels.objects

    @property
    def at(self) -> float:
        """The current moment (s after the beginning of the record)."""
        if self._playing:
            now = time.monotonic()
            self._at, self._since = self._at + (now - self._since) * self.speed, now
            if self._at >= self.story.lasted:
                self._at, self._playing = self.story.lasted, False
        return self._at

    @property
    def playing(self) -> bool:
        """Whether playback is running."""
        return self._playing

    def play(self) -> None:
        """Play; from the beginning if it is at the end."""
        if self.at >= self.story.lasted:
            self.seek(0.0)
        self._since, self._playing = time.monotonic(), True

    def pause(self) -> None:
        """Stay at the current moment."""
        self._playing, _ = False, self.at

    def seek(self, at: float) -> None:
        """Go to another moment (s)."""
        if at < self.at:
            self._reported.clear()
            self._voxels = VoxelBlocks()
        self._at, self._since = at, time.monotonic()

    def take(self, joint_names: tuple[str, ...]) -> News:
        """What has changed since the last call, or the whole state after a step back. The ghost is at the goal's
        commanded position.
        """
        at, found = self.at, []
        for key, times in self._times.items():
            index = bisect(times, at) - 1
            if index >= 0 and index != self._reported.get(key):
                self._reported[key] = index
                if (message := self._decoded(key, self._payloads[key][index])) is not None:
                    found.append((times[index], key, message))
        found.sort(key=lambda each: each[0])
        goals = tuple(message for _, _, message in found if isinstance(message, GoalState))
        tracked = next(((at, message) for at, _, message in reversed(found) if isinstance(message, GoalState)), None)
        newest: dict[str, Any] = {key: message for _, key, message in found}
        for _, key, message in found:
            if isinstance(message, VoxelBlock):
                self._voxels.receive(key, message)
            elif isinstance(message, PerceptionState):
                self._voxels.on_state(key, message)
        voxels = None if self._voxels.objects is self._shown else self._voxels.objects
        self._shown = self._voxels.objects
        measured = newest.get(self._keys.joint_states)
        joints = in_order(measured, joint_names) if isinstance(measured, JointState) else None
        return News(
            joints=None if joints is None else joints.position,
            velocity=None if joints is None else joints.velocity,
            measured_at=None if joints is None else joints.stamp,
            preview=np.array(goals[-1].joint_command) if goals else None,
            state=newest.get(self._keys.executor_state),
            strategies=newest.get(self._keys.strategy),
            servo=newest.get(self._keys.servo_state),
            plan=newest.get(self._keys.plans),
            scene=newest.get(self._keys.scene),
            voxels=voxels,
            simulated=newest.get(self._keys.physics_objects),
            physics=newest.get(self._keys.physics_state),
            goals=goals,
            grippers=tuple(message for _, _, message in found if isinstance(message, GripperState)),
            tracking_error=None if tracked is None else self._tracking_error(*tracked, joint_names),
        )

    def age(self) -> float | None:
        """The age (s) of the newest joint state at the current moment, None before the first."""
        times = self._times.get(self._keys.joint_states, [])
        index = bisect(times, self._at) - 1
        return self._at - times[index] if index >= 0 else None

    def _tracking_error(self, at: float, goal: GoalState, joint_names: tuple[str, ...]) -> Array | None:
        key = self._keys.joint_states
        index = bisect(self._times[key], at) - 1
        joints = self._decoded(key, self._payloads[key][index]) if index >= 0 else None
        if not isinstance(joints, JointState):
            return None
        return tracking_error(goal, joints, at - self._times[key][index], joint_names)

    def _decoded(self, key: str, payload: bytes) -> Message | None:
        model = self._recorded.model(key)
        try:
            return None if model is None else decode(model, payload)
        except InvalidRequest:  # an invalid message on the bus, recorded as it was
            return None
