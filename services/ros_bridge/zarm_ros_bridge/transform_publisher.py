"""/tf and /tf_static of the robot and the scene, as robot_state_publisher gives them, where nobody else does."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Iterable, Sequence
from types import TracebackType
from typing import Any, Self

from geometry_msgs.msg import TransformStamped
from numpy.typing import NDArray
from tf2_msgs.msg import TFMessage

from zarm_contract.errors import ZarmError
from zarm_contract.messages import Pose, Scene
from zarm_geometry.frames import pose_of
from zarm_ros_bridge.convert.poses import ros_pose
from zarm_ros_bridge.convert.times import ros_time
from zarm_ros_bridge.engine import Engine
from zarm_ros_bridge.frames import TF, TF_STATIC, Frames, placed
from zarm_ros_bridge.ros import Ros
from zarm_runtime.worker import Worker

PERIOD, AT_REST = 0.02, 0.1
"""How often (s) the moving frames are published while somebody listens, of a robot that moves and of one at rest."""
_JOINT_THRESHOLD = 1e-5
OTHERS_TIMEOUT = 2.0
"""How long (s) nobody else must have published the robot's frames."""
_LOOK_PERIOD = 0.5
MOST_OBJECTS = 200
"""Most objects of the scene that have a frame."""
_STAMPS_KEPT = 500


class TransformPublisher:
    """Publishes in its own thread. Use it in `with`.

    Frames of joints that do not move are published once, for all who come later, together with the first moving ones.
    """

    def __init__(self, ros: Ros, engine: Engine, frames: Frames) -> None:
        self._node = ros.node
        self._engine = engine
        self._frames = frames
        self._moving = ros.node.create_publisher(TFMessage, "/tf", TF)
        self._fixed = ros.node.create_publisher(TFMessage, "/tf_static", TF_STATIC)
        self._links = {joint.child for joint in engine.robot.urdf.joint_of_child.values() if joint.type != "fixed"}
        self._sent: deque[tuple[int, int]] = deque(maxlen=_STAMPS_KEPT)  # stamps of what was published here
        self._others_at = time.monotonic()
        self._scene: Scene | None = None
        self._wanted = self._listened = False
        self._looked_at = 0.0
        self._introduced = False
        self._before: Sequence[float] = engine.robot.descriptor.home
        self._published_at = 0.0
        self._worker = Worker("tf", self._run, _LOOK_PERIOD)
        frames.watch(self._on_tf)

    def __enter__(self) -> Self:
        self._worker.start()
        self._engine.bus.watch(self._engine.keys.scene, self._on_scene)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._worker.stop()

    def _on_scene(self, _: str, scene: Scene) -> None:
        self._scene = scene

    def _on_tf(self, transforms: Iterable[Any]) -> None:
        """Somebody has published: whoever moves the robot's frames with other stamps than ours is not we."""
        for one in transforms:
            if one.child_frame_id.removeprefix("/") in self._links:
                stamp = one.header.stamp
                if (stamp.sec, stamp.nanosec) not in self._sent:
                    self._others_at = time.monotonic()
                return

    def _run(self) -> float:
        """Publish if somebody listens and something has moved; the time (s) until it is looked again."""
        self._look()
        if not self._wanted:
            return _LOOK_PERIOD
        try:
            joints = self._frames.joints()
        except ZarmError:  # nothing is measured
            return PERIOD
        now = time.monotonic()
        if now - self._published_at >= AT_REST or _moved(self._before, joints):
            self._before, self._published_at = joints, now
            self._publish(joints)
        return PERIOD

    def _publish(self, joints: Sequence[float]) -> None:
        stamp = ros_time(time.time())
        self._sent.append((stamp.sec, stamp.nanosec))
        edges = list(self._frames.links.edges(joints))
        if not self._introduced:
            self._introduced = True
            fixed = [edge for edge in edges if edge[0].type == "fixed"]
            self._fixed.publish(TFMessage(transforms=_transforms(fixed, stamp)))
        moving = [edge for edge in edges if edge[0].type != "fixed"]
        self._moving.publish(TFMessage(transforms=[*_transforms(moving, stamp), *self._objects(stamp)]))

    def _look(self) -> None:
        """See, now and then, whether somebody beside this bridge listens, and nobody else publishes the robot."""
        now = time.monotonic()
        if now - self._looked_at > _LOOK_PERIOD:
            self._looked_at = now
            listeners = max(self._node.count_subscribers("/tf"), self._node.count_subscribers("/tf_static"))
            self._listened = listeners > 1
        self._wanted = self._listened and now - self._others_at > OTHERS_TIMEOUT

    def _objects(self, stamp: Any) -> list[Any]:
        scene, robot = self._scene, self._engine.robot.descriptor
        if scene is None:
            return []
        items: list[tuple[str, str, NDArray[Any]]] = [
            (robot.base_link, item.name, placed(item)) for item in scene.objects[:MOST_OBJECTS]
        ]
        items += [(one.link or robot.tip_link, one.object.name, placed(one)) for one in scene.attached]
        return [_transform(parent, name, pose_of(pose), stamp) for parent, name, pose in items]


def _moved(before: Sequence[float], now: Sequence[float]) -> bool:
    return max(abs(a - b) for a, b in zip(now, before, strict=True)) > _JOINT_THRESHOLD


def _transforms(edges: Iterable[tuple[Any, NDArray[Any]]], stamp: Any) -> list[Any]:
    return [_transform(joint.parent, joint.child, pose_of(pose), stamp) for joint, pose in edges]


def _transform(parent: str, child: str, pose: Pose, stamp: Any) -> Any:
    at = ros_pose(pose)
    message = TransformStamped(child_frame_id=child)
    message.header.frame_id, message.header.stamp = parent, stamp
    translation = message.transform.translation
    translation.x, translation.y, translation.z = at.position.x, at.position.y, at.position.z
    message.transform.rotation = at.orientation
    return message
