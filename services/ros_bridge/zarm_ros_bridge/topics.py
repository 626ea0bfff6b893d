"""What the bridge publishes on ROS: the robot, the ghost, the scene."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import JointState as RosJointState
from std_msgs.msg import String
from trajectory_msgs.msg import JointTrajectory
from visualization_msgs.msg import MarkerArray

from zarm_contract.messages import ExecutorState, JointState, Message, Plan, Scene
from zarm_contract.publications import deliver
from zarm_ros_bridge.convert.colours import Colour
from zarm_ros_bridge.convert.joints import ros_joint_state
from zarm_ros_bridge.convert.markers import obstacle_markers, sphere_markers
from zarm_ros_bridge.convert.trajectories import ros_joint_trajectory
from zarm_ros_bridge.description import shown_description
from zarm_ros_bridge.engine import Engine
from zarm_ros_bridge.ros import Ros

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
"""The last message is there for whoever comes late."""
DEPTH = 10

M = TypeVar("M", bound=Message)


class Topics:
    """Publishes under the names of the reference. `colours` (red, green, blue, alpha) are those of objects by name.

    Where the robot's own driver tells its joints on `joint_states`, the bridge does not: it would hear itself, and take an
    emulated robot for the real one.
    """

    def __init__(self, ros: Ros, engine: Engine, colours: dict[str, Colour]) -> None:
        self._engine = engine
        self._colours = colours
        self._emulated = False
        node, bus, keys = ros.node, engine.bus, engine.keys
        params = engine.robot.descriptor.strategy_params
        own = node.resolve_topic_name("joint_states")
        told = params is not None and node.resolve_topic_name(params.joint_states_topic) == own
        self._joint_states = None if told else node.create_publisher(RosJointState, own, DEPTH)
        self._emulator = node.create_publisher(RosJointState, "emulator/joint_states", DEPTH)
        self._ghost = node.create_publisher(RosJointState, "preview/joint_states", DEPTH)
        self._trajectory = node.create_publisher(JointTrajectory, "trajectory", DEPTH)
        self._obstacles = node.create_publisher(MarkerArray, "~/obstacles", LATCHED)
        self._spheres = node.create_publisher(MarkerArray, "~/collision_spheres", LATCHED)
        description = String(data=shown_description(engine.robot))
        self._descriptions = [
            node.create_publisher(String, name, LATCHED) for name in ("robot_description", "preview/robot_description")
        ]
        for publisher in self._descriptions:
            publisher.publish(description)
        self._spheres.publish(sphere_markers(engine.robot.descriptor))
        bus.watch(keys.executor_state, ExecutorState, self._state)
        bus.watch(keys.scene, Scene, self._scene)
        self._relay(keys.plans, Plan, lambda plan: ros_joint_trajectory(plan.trajectory), self._trajectory)
        self._relay(keys.joint_states, JointState, ros_joint_state, self._joint_states, self._emulator)
        self._relay(keys.preview_joint_states, JointState, ros_joint_state, self._ghost)

    def _state(self, _key: str, state: ExecutorState) -> None:
        self._emulated = state.strategy == "emulator"

    def _scene(self, _key: str, scene: Scene) -> None:
        descriptor = self._engine.robot.descriptor
        self._obstacles.publish(obstacle_markers(scene, descriptor.base_link, descriptor.tip_link, self._colours))

    def _relay(self, key: str, model: type[M], convert: Callable[[M], Any], *publishers: Publisher | None) -> None:
        """Publish what comes on a key of the bus. What nobody listens to is not even read: joints come at a high rate."""

        def receive(key: str, payload: bytes) -> None:
            heard = [
                publisher
                for publisher in publishers
                if publisher is not None
                and publisher.get_subscription_count()
                and (self._emulated or publisher is not self._emulator)
            ]
            if heard:
                deliver(key, payload, model, lambda _, message: publish(convert(message), heard))

        def publish(message: Any, heard: list[Publisher]) -> None:
            for publisher in heard:
                publisher.publish(message)

        self._engine.bus.listen(key, receive)
