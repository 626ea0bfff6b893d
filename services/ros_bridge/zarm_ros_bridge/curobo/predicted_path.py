"""Markers of a goal in closed loop for RViz: its target, and the verified path of the tip."""

from __future__ import annotations

import logging
import time
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Point, PoseStamped, Vector3
from nav_msgs.msg import Path
from std_msgs.msg import ColorRGBA, Header
from visualization_msgs.msg import Marker

from zarm_contract.errors import ZarmError
from zarm_contract.messages import Pose
from zarm_ros_bridge.convert.poses import ros_pose
from zarm_ros_bridge.convert.times import ros_time
from zarm_ros_bridge.curobo.live_target import LiveTarget
from zarm_ros_bridge.engine import Engine
from zarm_ros_bridge.ros import Ros
from zarm_runtime.worker import Worker
from zarm_trajectory.trajectory import TimedTrajectory

log = logging.getLogger(__name__)

_PERIOD = 0.2
"""Interval (s) of the updates."""
_ANSWER_SECONDS = 1.0
_ARROW = 0.1
"""Length (m) of the arrow along the z axis of the target."""
_COLOUR = ColorRGBA(r=0.2, g=0.8, b=0.4, a=0.9)


class PredictedPath:
    """Publishes `mpc_goal_marker`, and `mpc_predicted_path` while it has subscribers."""

    def __init__(self, ros: Ros, engine: Engine) -> None:
        self._engine = engine
        self._frame = engine.robot.descriptor.base_link
        self._marker = ros.node.create_publisher(Marker, "mpc_goal_marker", 1)
        self._path = ros.node.create_publisher(Path, "mpc_predicted_path", 1)

    @contextmanager
    def shown(self, live: LiveTarget, steps: int, step: float) -> Iterator[None]:
        """A block in which the target is shown, and the path for `steps` steps of `step` s."""
        times = step * np.arange(steps + 1)
        worker = Worker("mpc_predicted_path", lambda: self._show(live, times), _PERIOD)
        worker.wake()
        try:
            with worker:
                yield
        finally:
            self._marker.publish(Marker(action=Marker.DELETEALL))

    def _show(self, live: LiveTarget, times: np.ndarray) -> None:
        self._marker.publish(self._arrow(live.pose))
        if self._path.get_subscription_count():
            try:
                self._path.publish(self._predicted(times))
            except ZarmError as error:  # the robot is led regardless
                log.info("no predicted path reason=%s", error)

    def _predicted(self, times: np.ndarray) -> Path:
        """The tip along what the executor follows: the next steps, and the braking after them."""
        engine = self._engine
        followed = engine.client.connection.read(engine.keys.goal_trajectory, timeout=_ANSWER_SECONDS).trajectory
        trajectory = TimedTrajectory.of(followed, engine.joints)
        ahead = trajectory.time[0] + times
        positions, _, _ = trajectory.sample(ahead[ahead <= trajectory.time[-1]])
        tips = engine.client.fk([tuple(row) for row in positions.tolist()], timeout=_ANSWER_SECONDS)
        header = Header(frame_id=self._frame, stamp=ros_time(time.time()))
        return Path(header=header, poses=[PoseStamped(header=header, pose=ros_pose(tip)) for tip in tips])

    def _arrow(self, pose: Pose) -> Marker:
        """An arrow along the z axis of the target. With stamp 0, RViz shows it at the frame's present place."""
        marker = Marker(ns="mpc_goal", type=Marker.ARROW, action=Marker.ADD, pose=ros_pose(pose), color=_COLOUR)
        marker.header = Header(frame_id=self._frame, stamp=Time())
        marker.points = [Point(), Point(z=_ARROW)]
        marker.scale = Vector3(x=_ARROW / 10, y=_ARROW / 5)  # diameters of shaft and head
        return marker
