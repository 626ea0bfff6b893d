"""The newest messages of one robot from the bus, read by the page when it draws."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from zarm.robot import Robot
from zarm_contract.key import Latched
from zarm_contract.messages import (
    Cameras,
    ExecutorState,
    GoalState,
    GoalTrajectory,
    GripperState,
    JointState,
    Message,
    PhysicsObjects,
    PhysicsState,
    Plan,
    Planners,
    Scene,
    ServoState,
    Strategies,
    Voxels,
)
from zarm_geometry.voxel_blocks import VoxelBlocks
from zarm_trajectory.arrays import Array

_MAP_PERIOD = 0.5
"""Least time (s) between two drawings of the voxel map, and of depth images."""


@dataclass(frozen=True)
class News:
    """Changes since the last drawing; unchanged values are None. Joints are (J,) in rad, in the order of the
    descriptor, and were `measured_at` a time (Unix, s). `tracking_error` (J,) in rad is measured minus commanded, when the
    newest state of a goal came.
    """

    joints: Array | None = None
    velocity: Array | None = None
    measured_at: float | None = None
    preview: Array | None = None
    state: ExecutorState | None = None
    strategies: Strategies | None = None
    servo: ServoState | None = None
    scene: Scene | None = None
    voxels: Mapping[str, Voxels] | None = None
    plan: Plan | None = None
    planners: Planners | None = None
    trajectory: GoalTrajectory | None = None
    goals: tuple[GoalState, ...] = ()
    tracking_error: Array | None = None
    grippers: tuple[GripperState, ...] = ()
    cameras: Cameras | None = None
    images: Mapping[str, bytes] = field(default_factory=dict)
    masks: Mapping[str, bytes] = field(default_factory=dict)
    simulated: PhysicsObjects | None = None
    physics: PhysicsState | None = None


@dataclass
class Watching:
    """Subscriptions to one robot. High-rate joints are decoded only when taken, and images come only while the page is `seen()`."""

    robot: Robot
    seen: Callable[[], object]
    _lock: threading.Lock = field(default_factory=threading.Lock)
    _newest: dict[str, Any] = field(default_factory=dict)
    _goals: dict[str, GoalState] = field(default_factory=dict)
    _grippers: dict[str, GripperState] = field(default_factory=dict)
    _images: dict[str, bytes] = field(default_factory=dict)
    _masks: dict[str, bytes] = field(default_factory=dict)
    _images_taken: float = -math.inf
    _end_images: Callable[[], object] | None = None
    _tracked: tuple[GoalState, JointState, float] | None = None
    """The newest state of a goal, the joints when it came, and their age then (s)."""

    def __post_init__(self) -> None:
        bus, keys = self.robot.connection.bus, self.robot.connection.keys
        self._joints = bus.latest(keys.joint_states)
        self._preview = bus.latest(keys.preview_joint_states)
        self._physics = bus.latest(keys.physics_state)
        self._taken: dict[str, float] = {}
        self._voxels = VoxelBlocks()
        self._shown: tuple[Mapping[str, Voxels], float] = self._voxels.objects, -math.inf
        watched: dict[str, Latched[Any]] = {
            "state": keys.executor_state,
            "servo": keys.servo_state,
            "scene": keys.scene,
            "plan": keys.plans,
            "planners": keys.planners,
            "trajectory": keys.goal_trajectory,
            "strategies": keys.strategy,
            "cameras": keys.cameras,
            "simulated": keys.physics_objects,
        }
        for name, key in watched.items():
            bus.watch(key, self._put(name))
        bus.watch(keys.voxels("*"), self._voxels.receive)
        bus.watch(keys.perception_state, self._voxels.on_state)
        bus.watch(keys.goal("*"), self._put_goal)
        bus.watch(keys.gripper_state("*"), self._put_gripper)

    def take(self, joint_names: tuple[str, ...]) -> News:
        """Changes since the last call, with joints in this order."""
        self._choose_images()
        with self._lock:
            newest, self._newest = self._newest, {}
            goals, self._goals = tuple(self._goals.values()), {}
            grippers, self._grippers = tuple(self._grippers.values()), {}
            tracked, self._tracked = self._tracked, None
            images: dict[str, bytes] = {}
            masks: dict[str, bytes] = {}
            if time.monotonic() - self._images_taken >= _MAP_PERIOD:
                images, self._images, self._images_taken = self._images, {}, time.monotonic()
                masks, self._masks = self._masks, {}
        joints = self._new_joints("joints", self._joints.received(), joint_names)
        preview = self._new_joints("preview", self._preview.received(), joint_names)
        return News(
            joints=None if joints is None else joints.position,
            velocity=None if joints is None else joints.velocity,
            measured_at=None if joints is None else joints.stamp,
            preview=None if preview is None else preview.position,
            goals=goals,
            grippers=grippers,
            tracking_error=None if tracked is None else tracking_error(*tracked, joint_names),
            voxels=self._new_voxels(time.monotonic()),
            images=images,
            masks=masks,
            physics=self._new_physics(),
            **newest,
        )

    def age(self) -> float | None:
        """The age (s) of the newest joint state, None if none has come."""
        return time.monotonic() - self._taken["joints"] if "joints" in self._taken else None

    def _new_voxels(self, now: float) -> Mapping[str, Voxels] | None:
        """The voxel map by block, if it has changed and was not drawn just now."""
        blocks, (shown, at) = self._voxels.objects, self._shown
        if blocks is shown or now - at < _MAP_PERIOD:
            return None
        self._shown = blocks, now
        return blocks

    def _new_joints(
        self, name: str, received: tuple[JointState, float] | None, joint_names: tuple[str, ...]
    ) -> Ordered | None:
        if received is None or received[1] == self._taken.get(name):
            return None
        state, self._taken[name] = received
        return in_order(state, joint_names)

    def _new_physics(self) -> PhysicsState | None:
        received = self._physics.received()
        if received is None or received[1] == self._taken.get("physics"):
            return None
        state, self._taken["physics"] = received
        return state

    def _put(self, name: str) -> Callable[[str, Message], None]:
        def put(_: str, message: Message) -> None:
            with self._lock:
                self._newest[name] = message

        return put

    def _choose_images(self) -> None:
        bus, keys = self.robot.connection.bus, self.robot.connection.keys
        if self.seen() and self._end_images is None:
            ends = bus.listen(keys.depth("*"), self._put_image), bus.listen(keys.mask("*"), self._put_mask)
            self._end_images = lambda: [end() for end in ends]
        elif not self.seen() and self._end_images is not None:
            self._end_images()
            self._end_images = None

    def _put_image(self, key: str, payload: bytes) -> None:
        with self._lock:
            self._images[key.rpartition("/")[2]] = payload

    def _put_mask(self, key: str, payload: bytes) -> None:
        with self._lock:
            self._masks[key.rpartition("/")[2]] = payload

    def _put_gripper(self, _: str, state: GripperState) -> None:
        with self._lock:
            self._grippers[state.gripper] = state

    def _put_goal(self, _: str, goal: GoalState) -> None:
        received = self._joints.received()
        with self._lock:
            self._goals[goal.goal_id] = goal
            if received is not None:
                joints, at = received
                self._tracked = goal, joints, time.monotonic() - at


class Ordered(NamedTuple):
    """A joint state (J,) in the order of the descriptor."""

    position: Array
    velocity: Array
    stamp: float


def in_order(state: JointState, joint_names: tuple[str, ...]) -> Ordered | None:
    """A joint state in the order of `joint_names`; None if it is for other joints."""
    if set(state.joint_names) != set(joint_names):
        return None
    order = [state.joint_names.index(joint) for joint in joint_names]
    return Ordered(np.array(state.position)[order], np.array(state.velocity)[order], state.stamp)


def tracking_error(goal: GoalState, joints: JointState, age: float, joint_names: tuple[str, ...]) -> Array | None:
    """Measured minus commanded joints (J,) in rad, in the order of `joint_names`; the joints were measured `age` s before.

    None if they are other joints.
    """
    measured = in_order(joints, joint_names)
    if measured is None:
        return None
    return np.asarray(measured.position + age * measured.velocity - np.array(goal.joint_command))
