"""The topic monitored_planning_scene: the scene whole, and then what changes."""

from __future__ import annotations

import math
import time
from collections.abc import Callable

from moveit_msgs.msg import PlanningScene, PlanningSceneComponents

from zarm_contract.messages import Scene
from zarm_geometry.voxel_blocks import VoxelBlocks
from zarm_ros_bridge.moveit.planning_scene import PlanningSceneMessages
from zarm_ros_bridge.ros import Ros
from zarm_runtime.worker import Worker

Joints = tuple[float, ...]

STATE_PERIOD = 0.25
"""How often (s) the state of the robot is published in the scene while it moves, as MoveIt does by default."""
MAP_PERIOD = 0.5
"""Least time (s) between two octomaps in the scene."""
_MOVED = 1e-4


class MonitoredScene:
    """Publishes the scene to each new subscriber, and then its changes, the octomap and the motion of the robot. `joints()` is where the robot
    is, None if nobody knows.
    """

    def __init__(
        self, ros: Ros, messages: PlanningSceneMessages, voxels: VoxelBlocks, joints: Callable[[], Joints | None]
    ) -> None:
        self._messages, self._voxels, self._joints = messages, voxels, joints
        self._publisher = ros.node.create_publisher(PlanningScene, "monitored_planning_scene", 10)
        self._scene: Scene | None = None
        self._shown: Scene | None = None
        self._shown_at: Joints = ()
        self._subscribers = 0
        self._mapped, self._mapped_at = voxels.objects, -math.inf
        self._worker = Worker("planning scene", self._publish, STATE_PERIOD)

    def start(self) -> None:
        """Begin to publish."""
        self._worker.start()

    def stop(self) -> None:
        """End."""
        self._worker.stop()

    def change(self, scene: Scene) -> None:
        """This is the scene from now on."""
        self._scene = scene
        self._worker.wake()

    def _publish(self) -> None:
        scene, before = self._scene, self._subscribers
        self._subscribers = self._publisher.get_subscription_count()
        if scene is None or not self._subscribers:
            self._shown = None
            return
        joints = self._joints()
        if scene is not self._shown or self._subscribers > before:
            self._publisher.publish(self._messages.message(scene, joints))
            self._shown, self._shown_at = scene, joints or ()
            self._mapped, self._mapped_at = self._voxels.objects, time.monotonic()
        elif self._voxels.objects is not self._mapped and time.monotonic() - self._mapped_at > MAP_PERIOD:
            self._mapped, self._mapped_at = self._voxels.objects, time.monotonic()
            self._publisher.publish(self._messages.seen())
        elif joints is not None and _differ(joints, self._shown_at):
            diff = self._messages.message(scene, joints, PlanningSceneComponents.ROBOT_STATE)
            diff.is_diff = diff.robot_state.is_diff = True
            self._publisher.publish(diff)
            self._shown_at = joints


def _differ(a: Joints, b: Joints) -> bool:
    return len(a) != len(b) or any(abs(x - y) > _MOVED for x, y in zip(a, b, strict=True))
