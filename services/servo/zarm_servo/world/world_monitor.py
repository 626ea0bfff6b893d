"""The one reader of what the bus says of scene, robot and goals; it knows none of those whom it informs."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from pydantic import TypeAdapter, ValidationError

from zarm_contract.descriptor import RobotDescriptor
from zarm_contract.keys import Keys
from zarm_contract.messages import ExecutorState, GoalState, GoalTrajectory, JointState, Message, SceneObject
from zarm_geometry.gripper_openings import GripperOpenings
from zarm_geometry.meshes import Meshes
from zarm_geometry.voxel_blocks import VoxelBlocks
from zarm_runtime import clock
from zarm_runtime.bus import Bus, Latest
from zarm_runtime.worker import Worker
from zarm_servo.world.moving_objects import MovingObjects
from zarm_servo.world.robot_lag import RobotLag
from zarm_servo.world.scene_monitor import SceneMonitor

log = logging.getLogger(__name__)

PLANNER_PERIOD = 1.0
"""Interval (s) at which the planner's presence is checked."""
MISSED = 2
"""A planner counts as gone after so many checks: on a busy machine the answer to one may come too late."""
_OBJECT: TypeAdapter[SceneObject] = TypeAdapter(SceneObject)


class WorldMonitor:
    """The scene, the objects that move in it, the `measured` joints and how late they are.

    Callables in `on_change` are called after every change of the scene, those in `on_move` after every pose of an object,
    and the others with each message of the executor; all from any thread. An exception of one is logged, and does not
    keep the others from being called.
    """

    def __init__(self, measured: Latest[JointState], meshes: Meshes, descriptor: RobotDescriptor) -> None:
        self.measured = measured
        self.on_change: list[Callable[[], object]] = []
        self.on_move: list[Callable[[], object]] = []
        self.on_state: list[Callable[[ExecutorState], object]] = []
        self.on_goal: list[Callable[[GoalState], object]] = []
        self.on_trajectory: list[Callable[[GoalTrajectory], object]] = []
        self.planner_gone = False
        self._missed = 0
        self.scene = SceneMonitor(lambda: _call(self.on_change))
        self.grippers = GripperOpenings(descriptor, lambda: self.scene.on_openings(self.grippers.present()))
        self.scene.on_openings(self.grippers.present())
        self.voxels = VoxelBlocks(lambda: self.scene.on_voxels(self.voxels.objects))
        self.moving = MovingObjects(self.scene, meshes, lambda: _call(self.on_move))
        self.lag = RobotLag()
        self.on_state.append(self.lag.on_state)
        self.on_goal.append(self.lag.on_goal)

    @contextmanager
    def reading(self, bus: Bus, keys: Keys) -> Iterator[None]:
        """Read the bus in this block."""
        bus.watch(keys.gripper_state("*"), self.grippers.receive)
        bus.watch(keys.scene, self.scene.on_scene)
        bus.watch(keys.voxels("*"), self.voxels.receive)
        bus.watch(keys.perception_state, self.voxels.on_state)
        bus.listen(keys.scene_object("*"), self._on_object)
        bus.watch(keys.executor_state, lambda _, state: _call(self.on_state, state))
        bus.watch(keys.goal("*"), lambda _, goal: _call(self.on_goal, goal))
        bus.watch(keys.goal_trajectory, lambda _, trajectory: _call(self.on_trajectory, trajectory))
        with Worker("planner", lambda: self._look_for_planner(bus, keys), PLANNER_PERIOD):
            yield

    def _on_object(self, key: str, payload: bytes) -> None:
        try:
            self.scene.on_object(_OBJECT.validate_json(payload[: Message.max_bytes]), clock.monotonic())
        except ValidationError as error:
            log.warning("dropped a message key=%s reason=%s", key, error.errors()[0]["msg"])

    def _look_for_planner(self, bus: Bus, keys: Keys) -> None:
        alive = bus.alive(keys.alive("planner", "*"), timeout=PLANNER_PERIOD)
        self._missed = 0 if alive else self._missed + 1
        self.planner_gone = self._missed >= MISSED


def _call(callables: list[Callable[..., object]], *arguments: object) -> None:
    for one in callables:
        try:
            one(*arguments)
        except Exception:  # whatever one of them does wrong, the others must know, above all the guard
            log.exception("not informed callable=%s", one)
