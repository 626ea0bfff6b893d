"""The topics of a trajectory controller of ros2_control: trajectories for the robot, and how it follows them."""

from __future__ import annotations

import threading
import time
from types import TracebackType
from typing import Any, Self

from control_msgs.msg import JointTrajectoryControllerState
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from zarm.connection import ANSWER_SECONDS
from zarm_contract.errors import ZarmError
from zarm_contract.messages import ExecuteRequest, ExecutorState
from zarm_ros_bridge.convert.joint_trajectories import starts_in, trajectory_of
from zarm_ros_bridge.convert.times import ros_time
from zarm_ros_bridge.engine import Engine
from zarm_ros_bridge.frames import Frames
from zarm_ros_bridge.ros import Ros
from zarm_runtime.worker import Worker

NAME = "zarm_controller/{}"
"""Relative to the namespace of the bridge."""
_PERIOD = 0.02
_UNSEEN = 0.5
"""s between two looks at whether somebody subscribes to the state."""


class ControllerTopics:
    """`joint_trajectory` takes the place of what runs at its stamp, and of one that has not begun yet, as for a controller, and nobody hears how it ends;
    one without points stops the robot.
    `controller_state` is published at 50 Hz while somebody subscribes to it.
    """

    def __init__(self, ros: Ros, engine: Engine, frames: Frames) -> None:
        self._ros, self._engine, self._frames = ros, engine, frames
        self._state: ExecutorState | None = None
        self._next: threading.Timer | None = None
        self._publisher = ros.node.create_publisher(JointTrajectoryControllerState, NAME.format("controller_state"), 1)
        ros.listen(
            JointTrajectory,
            NAME.format("joint_trajectory"),
            self._receive,
            1,
        )
        engine.bus.watch(engine.keys.executor_state, self._on_state)
        self._worker = Worker("controller state", self._publish, _UNSEEN)

    def __enter__(self) -> Self:
        self._worker.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._worker.stop()
        self._withdraw()

    def _on_state(self, _key: str, state: ExecutorState) -> None:
        self._state = state

    def _receive(self, message: Any) -> None:
        try:
            wait = starts_in(message, "trajectory")
        except ZarmError as error:
            self._warn(error)
            return
        self._withdraw()
        self._next = threading.Timer(wait, self._ros.run, [lambda: self._move(message)])
        self._next.start()

    def _withdraw(self) -> None:
        """Forget a trajectory that has not begun."""
        if self._next is not None:
            self._next.cancel()
            self._next.join()

    def _move(self, message: Any) -> None:
        client = self._engine.client
        try:
            if not message.points:
                client.cancel()
                return
            motion = trajectory_of(message, self._engine.joints, self._frames.joints, "trajectory")
            if motion is not None:
                client.start(ExecuteRequest(trajectory=motion, preempt=True), timeout=ANSWER_SECONDS)
        except ZarmError as error:
            self._warn(error)

    def _warn(self, error: ZarmError) -> None:
        self._ros.node.get_logger().warning(f"{NAME.format('joint_trajectory')}: {error}")

    def _publish(self) -> float:
        """Publish the state if somebody listens; the time (s) until the next one."""
        if not self._publisher.get_subscription_count():
            return _UNSEEN
        self._publish_state()
        return _PERIOD

    def _publish_state(self) -> None:
        try:
            measured = list(self._frames.joints())
        except ZarmError:  # nobody reports the joints: there is no state
            return
        state = self._state
        goal = None if state is None else self._engine.goal(state)
        reference = measured if goal is None else list(goal.joint_command)
        message = JointTrajectoryControllerState(
            joint_names=list(self._engine.joints),
            reference=JointTrajectoryPoint(positions=reference),
            feedback=JointTrajectoryPoint(positions=measured),
            error=JointTrajectoryPoint(positions=[a - b for a, b in zip(reference, measured, strict=True)]),
            speed_scaling_factor=1.0 if state is None else state.speed_scale,
        )
        message.header.stamp = ros_time(time.time())
        self._publisher.publish(message)
