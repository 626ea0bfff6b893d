"""The router goes and comes again: clients on ROS are told, and then all is as before, without anybody starting anything."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory
from visualization_msgs.msg import MarkerArray

from curobo_msgs.srv import AddObject, SetRobotStrategy, TrajectoryGeneration
from support.harness import ServiceProcess, eventually, free_endpoint
from support.network.link import link
from support.ros.client import reported
from support.ros.goals import ABORTED, HOME, SUCCEEDED, TARGET, Actions, Robot
from support.ros.node import running_node
from support.ros.stack import KEYS, RosClient
from zarm_contract.messages import AddObjects, Cylinder, Plan, SceneEdit
from zarm_ros_bridge.goals import SILENCE
from zarm_runtime.bus import Bus
from zarm_runtime.session import open_router

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
ASIDE = [HOME[0] + 0.3, *HOME[1:]]


class Place:
    """Every process of a robot with a driver on ROS, a client on ROS, and a router that can be taken away.

    The bridge has a link to the router that can be cut.
    """

    def __init__(self, stack: ExitStack, folder: Path) -> None:
        self._endpoint = free_endpoint()
        self._router = stack.enter_context(ExitStack())
        self.start_router()
        self.bus = stack.enter_context(Bus(self._endpoint))
        self.node: Node = stack.enter_context(running_node("client"))
        self.ros, self.actions, self.robot = RosClient(self.node), Actions(self.node), Robot(self.bus, KEYS)
        self.link = stack.enter_context(link(self._endpoint))
        self.processes = [
            ServiceProcess(name, endpoint, folder, name=KEYS.robot, arguments=arguments)
            for name, endpoint, arguments in (
                ("planner", self._endpoint, ()),
                ("executor", self._endpoint, ()),
                ("ros_bridge", self.link.endpoint, ()),
                ("leeloo_sim", self._endpoint, ("--ros",)),
            )
        ]
        for process in self.processes:
            stack.enter_context(process)
        for process in self.processes:
            process.wait_ready(self.bus, KEYS)

    def start_router(self) -> None:
        self._router.enter_context(open_router(self._endpoint))

    def stop_router(self) -> None:
        self._router.close()

    def heard(self, kind: Any, topic: str, qos: QoSProfile | int = 10) -> list[Any]:
        messages: list[Any] = []
        self.node.create_subscription(kind, topic, messages.append, qos)
        return messages

    def joined(self) -> None:
        """Wait until planner and executor answer the bridge."""
        for name in ("get_robot_strategy", "get_obstacles"):
            eventually(lambda at=name: self.ros.call(Trigger, at).success, f"{name} is answered again")

    def switch(self, strategy: str) -> None:
        eventually(
            lambda: self.ros.call(SetRobotStrategy, "set_robot_strategy", robot_strategy=strategy).success,
            f"{strategy} is active",
        )


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Place]:
    with ExitStack() as stack:
        one = Place(stack, tmp_path_factory.mktemp("router"))
        yield one
        for process in one.processes:
            assert process.process.poll() is None, process.output()
            assert "Traceback" not in process.output()


def test_without_a_router_services_say_so_and_recover(place: Place) -> None:
    place.robot.plan()
    place.stop_router()
    for kind, name, request in (
        (Trigger, "get_robot_strategy", {}),
        (Trigger, "get_obstacles", {}),
        (TrajectoryGeneration, "generate_trajectory", {"target_joint_positions": ASIDE}),
        (SetRobotStrategy, "set_robot_strategy", {"robot_strategy": "ghost"}),
    ):
        response = place.ros.call(kind, name, **request)
        assert not response.success, name
        assert "has not answered" in response.message
    for goal in ({}, {"target_pose": TARGET}):
        status, result = place.actions.send(**goal).ended()
        assert status == ABORTED
        assert "has not answered" in result.message

    place.start_router()
    place.joined()
    obstacles = place.heard(MarkerArray, "/unified_planner/obstacles", LATCHED)
    box = AddObject.Request(type=AddObject.Request.SPHERE, name="ball")
    box.pose.position.x, box.dimensions.x = 2.0, 0.1
    added = place.ros.call(
        AddObject, "add_object", type=box.type, name=box.name, pose=box.pose, dimensions=box.dimensions
    )
    assert added.success, added.message

    def names(messages: list[MarkerArray]) -> bool:
        return bool(messages) and any(marker.text == "ball" or marker.ns == "ball" for marker in messages[-1].markers)

    eventually(lambda: names(obstacles), "the object is shown")
    late = place.heard(MarkerArray, "/unified_planner/obstacles", LATCHED)
    eventually(lambda: names(late), "the object is shown to whoever comes late")
    eventually(place.heard(String, "/robot_description", LATCHED).__len__, "the description is there")
    eventually(place.heard(JointState, "/joint_states").__len__, "the joints are told")
    trajectories = place.heard(JointTrajectory, "/trajectory")
    place.switch("joint_speed")
    commands = place.heard(JointTrajectory, "/leeloo/execute_trajectory")
    plans: list[Plan] = []
    reported(trajectories, lambda: plans.append(place.robot.plan(speed=1.0)), "the plan is shown")
    status, result = place.actions.send().ended()
    assert status == SUCCEEDED, result.message
    assert commands
    np.testing.assert_allclose(place.robot.joints(), plans[-1].trajectory.position[-1], atol=0.005)
    place.switch("emulator")


def test_a_goal_outlives_a_restart_of_the_router(place: Place) -> None:
    place.robot.plan(speed=0.15)
    goal = place.actions.send()
    goal.under_way()
    place.stop_router()
    place.start_router()
    status, result = goal.ended()
    assert status == SUCCEEDED, result.message
    place.joined()


@pytest.mark.slow
def test_a_silent_goal_is_aborted_and_the_next_one_runs(
    place: Place,
) -> None:
    place.robot.plan(speed=0.15)
    goal = place.actions.send()
    goal.under_way()
    place.stop_router()
    status, result = goal.ended()
    assert status == ABORTED
    assert f"for {SILENCE:g} s" in result.message
    place.start_router()
    place.joined()
    place.robot.plan()
    status, result = place.actions.send().ended()
    assert status == SUCCEEDED, result.message


def test_a_reconnected_bridge_shows_the_scene_edited_meanwhile(place: Place) -> None:
    shown = place.heard(MarkerArray, "/unified_planner/obstacles", LATCHED)
    eventually(shown.__len__, "the scene is shown")
    for name in ("pillar", "post"):
        place.link.cut()
        pole = Cylinder(kind="cylinder", name=name, position=(2.0, 0.0, 0.5), radius=0.1, length=1.0)
        edit = SceneEdit(edit=AddObjects(op="add", objects=(pole,)))
        place.bus.call(KEYS.scene_edit, edit, timeout=10)
        place.link.restore()
        eventually(
            lambda wanted=name: any(marker.ns == wanted for marker in shown[-1].markers),
            "what came meanwhile is shown",
        )
    place.joined()
