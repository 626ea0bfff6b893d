"""The simulated driver on ROS 2, on the topics of the real one. Only this module imports rclpy, with `--ros`."""

from __future__ import annotations

import itertools
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager

import numpy as np
import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.task import Future
from sensor_msgs.msg import JointState
from std_msgs.msg import Float32
from trajectory_msgs.msg import JointTrajectory

from zarm_contract.descriptor import StrategyParams
from zarm_runtime import dds
from zarm_simulated_driver.axes import Axes
from zarm_simulated_driver.driver import Command, PlaybackProgress
from zarm_trajectory.arrays import Array

DEPTH = 10
"""Queue depth of each topic, as with the real driver."""
JOINT_STATES = QoSProfile(
    depth=DEPTH, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL
)
"""As observed with the real driver on Humble."""


class RosSide:
    """Commands in, joint states and progress out, on the topics of `params`.

    A trajectory is read by index; its names and times are ignored.
    """

    def __init__(self, node: Node, params: StrategyParams, axes: Axes) -> None:
        self._node, self._axes = node, axes
        self._command_topic = params.command_topic
        self._joints = node.create_publisher(JointState, params.joint_states_topic, JOINT_STATES)
        topic = params.state_topic
        self._progress = None if topic is None else node.create_publisher(Float32, topic, DEPTH)

    def listen(self, play: Callable[[Command], None]) -> None:
        """From now on play arriving trajectories; numbered by arrival, as ROS does not number them."""
        numbers = itertools.count(1)

        def received(trajectory: JointTrajectory) -> None:
            points = trajectory.points
            play(
                Command(
                    next(numbers),
                    self._rows([point.positions for point in points]),
                    self._rows([point.velocities for point in points]),
                )
            )

        self._node.create_subscription(JointTrajectory, self._command_topic, received, DEPTH)

    def publish_joints(self, position: Array, velocity: Array, effort: Array | None) -> None:
        """Publish the joint positions (J,) rad, velocities (J,) rad/s and efforts (J,) Nm, NaN if unknown."""
        axes = self._axes
        message = JointState(
            name=axes.reported_joints,
            position=axes.as_reported(position),
            velocity=axes.as_reported(velocity),
            effort=[float("nan")] * len(axes.reported_joints) if effort is None else axes.as_reported(effort),
        )
        message.header.stamp = self._node.get_clock().now().to_msg()
        self._joints.publish(message)

    def publish_progress(self, progress: PlaybackProgress) -> None:
        """Publish points played / points received; nothing for a stop, which has none."""
        if self._progress is not None and progress.total:
            self._progress.publish(Float32(data=progress.fraction))

    def _rows(self, points: Sequence[Sequence[float]]) -> Array:
        """(N, J): a row for each point; NaN if the point has fewer values than there are joints."""
        count = len(self._axes.names)
        rows = np.full((len(points), count), np.nan)
        for row, values in zip(rows, points, strict=True):
            if len(values) >= count:
                row[:] = values[:count]
        return rows


@contextmanager
def ros_side(name: str, params: StrategyParams, axes: Axes) -> Iterator[RosSide]:
    """A node `name`, whose commands are received by its own thread until the end."""
    with ExitStack() as stack:
        dds.join()
        context = Context()
        rclpy.init(context=context)
        stack.callback(context.shutdown)
        node = Node(name, context=context, enable_rosout=False)
        stack.callback(node.destroy_node)
        executor = SingleThreadedExecutor(context=context)
        executor.add_node(node)
        stack.callback(executor.shutdown)
        ended = Future()
        thread = threading.Thread(target=executor.spin_until_future_complete, args=(ended,), name="ros")
        thread.start()
        stack.callback(thread.join)
        stack.callback(ended.set_result, None)
        yield RosSide(node, params, axes)
