"""Frames of ROS: the robot's links, objects of the scene, and whatever is published on /tf and /tf_static."""

from __future__ import annotations

import threading
import time
from bisect import bisect_left
from collections import deque
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from rclpy.qos import DurabilityPolicy, QoSProfile
from tf2_msgs.msg import TFMessage

from zarm_contract.codec import decode
from zarm_contract.errors import ExecutionRefused, Unavailable
from zarm_contract.messages import Attached, JointState, Pose, SceneObject
from zarm_contract.messages import Sphere as Ball
from zarm_geometry.frames import matrix, pose_of
from zarm_ros_bridge.convert.joints import known_as
from zarm_ros_bridge.convert.times import NANOSECONDS
from zarm_ros_bridge.engine import Engine
from zarm_ros_bridge.grippers import Grippers
from zarm_ros_bridge.link_frames import LinkFrames
from zarm_ros_bridge.ros import Ros
from zarm_ros_bridge.transforms import HISTORY, Transforms, UnknownFrame
from zarm_trajectory.arrays import Array

PATIENCE = 0.5
"""How long (s) a transform may be on its way."""
TF = QoSProfile(depth=100)
TF_STATIC = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)
"""The QoS of the topics, as in tf2."""
OLD = 1.0
"""Joints that are older (s) are not where the robot is now."""
_POLL = 0.02
_STATES = 5000  # most joint states in HISTORY


class Frames:
    """Looks up frames. Thread-safe."""

    def __init__(self, ros: Ros, engine: Engine, grippers: Grippers) -> None:
        self._engine = engine
        self.links = LinkFrames(engine.robot, grippers.positions)
        self._published = Transforms()
        self._on_moving: Callable[[Sequence[Any]], None] = lambda _: None
        self._history = _JointHistory(engine)
        ros.listen(TFMessage, "/tf", lambda message: self._put(message, fixed=False), TF)
        ros.listen(TFMessage, "/tf_static", lambda message: self._put(message, fixed=True), TF_STATIC)

    def remember(self) -> None:
        """Remember from now on where the robot was, for times in the past; else the first look-up begins it."""
        self._history.begin()

    def watch(self, on_moving: Callable[[Sequence[Any]], None]) -> None:
        """Call `on_moving` with the transforms of each message on /tf. Call before `spin`."""
        self._on_moving = on_moving

    def in_base(self, pose: Pose, header: Any, field: str) -> Pose:
        """The pose given in the frame of `header`, in the base frame. Raises UnknownFrame, with the `field` of the header."""
        frame = self.pose_of(header.frame_id, _seconds(header.stamp), field)
        return pose if frame is None else pose_of(frame @ matrix(pose.position, pose.orientation))

    def found(self, header: Any, field: str) -> Array | None:
        """The pose (4, 4) of the frame of `header`, None if it is the base frame, at once. Raises UnknownFrame."""
        return self.pose_of(header.frame_id, _seconds(header.stamp), field, patience=0.0)

    def pose_of(
        self, frame_id: str, stamp: float = 0.0, field: str = "header", *, patience: float = PATIENCE
    ) -> Array | None:
        """The pose (4, 4) in the base frame that a frame has at `stamp` (s; 0: now), None if it is the base frame.

        Waits up to `patience` s for it. Raises UnknownFrame.
        """
        name = known_as(frame_id.removeprefix("/"), self.links.links)
        if name in ("", self.links.base):
            return None
        deadline = time.monotonic() + patience
        while True:
            try:
                return self._looked_up(name, stamp)
            except UnknownFrame as error:
                if time.monotonic() > deadline:
                    at = f"{field}.{(error.problem.field or 'header.frame_id').removeprefix('header.')}"
                    raise UnknownFrame(error.problem.message, field=at) from error
            time.sleep(_POLL)

    def joints(self) -> tuple[float, ...]:
        """The positions of the joints (rad), as measured now. Raises Unavailable and ExecutionRefused where nothing is."""
        return self._history.at(0.0)

    def links_at(self, stamp: float = 0.0) -> dict[str, Array]:
        """The pose (4, 4) of each link in the base frame at `stamp` (s; 0: now). Raises UnknownFrame."""
        return self.links.poses(self._history.at(stamp))

    def _looked_up(self, name: str, stamp: float) -> Array:
        up, pose = self._climb(name, stamp)
        if up in self.links.links:
            return pose if up == self.links.base else self.links_at(stamp)[up] @ pose
        if (item := self._object(up)) is not None:
            return item @ pose
        for link in (self.links.base, self.links.links[0]):  # what the robot stands on
            root, base = self._climb_from(link, stamp)
            if root == up:
                placed = np.eye(4) if link == self.links.base else self.links_at(stamp)[link]
                return placed @ np.linalg.inv(base) @ pose
        known = sorted({*self.links.links, *self._published.names()})
        raise UnknownFrame(
            f"the frame {name!r} is not connected to {self.links.base}; known are {', '.join(known[:20])}"
            f"{' and more' if len(known) > 20 else ''}, and the objects of the scene",
            field="header.frame_id",
        )

    def _climb(self, name: str, stamp: float) -> tuple[str, Array]:
        """The first link of the robot above a frame, or the root of its tree, and the frame's pose there."""
        return (name, np.eye(4)) if name in self.links.links else self._climb_from(name, stamp)

    def _climb_from(self, name: str, stamp: float) -> tuple[str, Array]:
        pose, seen = np.eye(4), {name}
        while (parent := self._published.parent(name)) is not None:
            pose = self._published.in_parent(name, stamp) @ pose
            name = parent
            if name in self.links.links or name in seen:
                break
            seen.add(name)
        return name, pose

    def _object(self, name: str) -> Array | None:
        """The pose of an object of the scene."""
        scene = self._engine.client.scene.read()
        for item in scene.objects:
            if item.name == name:
                return placed(item)
        for attached in scene.attached:
            if attached.object.name == name:
                link = attached.link or self._engine.robot.descriptor.tip_link
                return self.links_at()[link] @ placed(attached)
        return None

    def _put(self, message: Any, *, fixed: bool) -> None:
        if not fixed:
            self._on_moving(message.transforms)
        for one in message.transforms:
            t, r = one.transform.translation, one.transform.rotation
            stamp = None if fixed else _seconds(one.header.stamp)
            try:
                pose = Pose(position=(t.x, t.y, t.z), orientation=(r.x, r.y, r.z, r.w))
            except ValueError:  # as tf2, which drops what is no transform
                continue
            child, parent = (name.removeprefix("/") for name in (one.child_frame_id, one.header.frame_id))
            if child and parent and child != parent:
                self._published.put(parent, child, stamp, pose)


class _JointHistory:
    """The measured joints of the last HISTORY s, decoded only where somebody asks."""

    def __init__(self, engine: Engine) -> None:
        self._joints = engine.joints
        self._turn = threading.Lock()
        self._payloads: deque[bytes] = deque(maxlen=_STATES)
        self._came = threading.Event()
        self._received_at = 0.0
        self._begun = False
        self._engine = engine

    def begin(self) -> None:
        """Keep joint states from now on: they wake this process up a hundred times a second."""
        with self._turn:
            begun, self._begun = self._begun, True
        if not begun:
            self._engine.bus.listen(self._engine.keys.joint_states, self._receive)

    def at(self, stamp: float) -> tuple[float, ...]:
        """The position of the joints at `stamp` (s; 0: now). Raises UnknownFrame, Unavailable without any, and
        ExecutionRefused where the last ones are old.
        """
        self.begin()
        if not self._came.wait(PATIENCE):
            raise Unavailable("no joint state has come yet; start the executor and the driver")
        with self._turn:
            payloads, age = list(self._payloads), time.monotonic() - self._received_at
        if not stamp and age > OLD:
            raise ExecutionRefused(
                f"the last joint state came {age:.1f} s ago; see whether the executor and the driver run",
                code="no_joint_state",
            )
        last = decode(JointState, payloads[-1])
        if not stamp or stamp >= last.stamp:
            return last.position
        after = bisect_left(payloads, stamp, key=lambda payload: decode(JointState, payload).stamp)
        end = decode(JointState, payloads[after])
        if after == 0 and end.stamp > stamp + 1e-9:
            raise UnknownFrame(
                f"where the robot was at {stamp:.3f} is not known, only since {end.stamp:.3f}; at most the last "
                f"{HISTORY:g} s are kept",
                field="header.stamp",
            )
        start = decode(JointState, payloads[max(after - 1, 0)])
        share = (stamp - start.stamp) / ((end.stamp - start.stamp) or 1.0)
        return tuple((1.0 - share) * a + share * b for a, b in zip(start.position, end.position, strict=True))

    def _receive(self, _: str, payload: bytes) -> None:
        with self._turn:
            self._payloads.append(payload)
            self._received_at = time.monotonic()
        self._came.set()


def placed(item: SceneObject | Attached) -> Array:
    """The pose (4, 4) of an object in the base frame, or of an attached one in that of the tip."""
    thing = item.object if isinstance(item, Attached) else item
    return matrix(thing.position) if isinstance(thing, Ball) else matrix(thing.position, thing.orientation)


def _seconds(stamp: Any) -> float:
    return float(stamp.sec + stamp.nanosec / NANOSECONDS)
