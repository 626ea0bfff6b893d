"""Topics published by the bridge: the robot, the ghost, the scene."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Self

from sensor_msgs.msg import JointState as RosJointState
from std_msgs.msg import String
from trajectory_msgs.msg import JointTrajectory
from visualization_msgs.msg import Marker, MarkerArray

from zarm_contract.messages import ExecutorState, JointState, Plan, Scene
from zarm_ros_bridge.convert.colours import Colour
from zarm_ros_bridge.convert.joints import ros_joint_state
from zarm_ros_bridge.convert.markers import obstacle_markers, sphere_markers
from zarm_ros_bridge.convert.trajectories import ros_joint_trajectory
from zarm_ros_bridge.description import shown_description
from zarm_ros_bridge.engine import Engine
from zarm_ros_bridge.grippers import Grippers
from zarm_ros_bridge.relay import DEPTH, Relay
from zarm_ros_bridge.ros import LATCHED, Ros
from zarm_runtime.publications import deliver


class Topics:
    """Publishes under the names of the reference, with the scene as `obstacles`. `colours` (red, green, blue, alpha)
    are those of objects by name.

    If the robot's own driver publishes its joints on `joint_states`, the bridge does not: it would hear itself, and
    take an emulated robot for the real one. Use it in `with`.
    """

    def __init__(
        self, ros: Ros, engine: Engine, grippers: Grippers, colours: dict[str, Colour], *, obstacles: Sequence[str]
    ) -> None:
        self._engine = engine
        self._colours = colours
        self._emulated = False
        self._changed_under: str | None = None
        node, bus, keys = ros.node, engine.bus, engine.keys
        self._log = node.get_logger()
        params = engine.robot.descriptor.strategy_params
        own = node.resolve_topic_name("joint_states")
        reported = params is not None and node.resolve_topic_name(params.joint_states_topic) == own
        self._trajectory = node.create_publisher(JointTrajectory, "trajectory", DEPTH)
        self._obstacles = [node.create_publisher(MarkerArray, topic, LATCHED) for topic in obstacles]
        self._spheres = node.create_publisher(MarkerArray, "~/collision_spheres", LATCHED)
        description = String(data=shown_description(engine.robot))
        self._descriptions = [
            node.create_publisher(String, name, LATCHED) for name in ("robot_description", "preview/robot_description")
        ]
        for publisher in self._descriptions:
            publisher.publish(description)
        bus.watch(keys.executor_state, self._state)
        bus.watch(keys.scene, self._scene)
        # Plans are rare, and one published before its bus subscriber is known would not be sent again.
        bus.listen(keys.plans, self._plan)
        robot = {"emulator/joint_states": lambda: self._emulated} | ({} if reported else {own: lambda: True})
        self._relays = [
            Relay(
                node, bus, key, JointState, RosJointState, lambda state: ros_joint_state(grippers.beside(state)), topics
            )
            for key, topics in (
                (keys.joint_states, robot),
                (keys.preview_joint_states, {"preview/joint_states": lambda: True}),
            )
        ]

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        for relay in self._relays:
            relay.close()

    def _plan(self, key: str, payload: bytes) -> None:
        if self._trajectory.get_subscription_count():
            deliver(key, payload, Plan, lambda _, plan: self._trajectory.publish(ros_joint_trajectory(plan.trajectory)))

    def _state(self, _key: str, state: ExecutorState) -> None:
        self._emulated = state.strategy == "emulator"
        if state.scene_changed and state.goal_id != self._changed_under:
            self._changed_under = state.goal_id
            self._log.warning(f"The scene has changed since the motion {state.goal_id} was checked.")

    def _scene(self, _key: str, scene: Scene) -> None:
        descriptor = self._engine.robot.descriptor
        markers = obstacle_markers(scene, descriptor.base_link, descriptor.tip_link, self._colours)
        for publisher in self._obstacles:
            publisher.publish(markers)

    def show_spheres(self, shown: bool) -> None:
        """Show or hide the robot's collision spheres."""
        robot = self._engine.robot.descriptor
        self._spheres.publish(
            sphere_markers(robot) if shown else MarkerArray(markers=[Marker(action=Marker.DELETEALL)])
        )
