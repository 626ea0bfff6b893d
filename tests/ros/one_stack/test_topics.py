"""What the bridge publishes: the robot, the ghost, the emulated robot, the scene, the description."""

from __future__ import annotations

from collections.abc import Iterator
from xml.etree import ElementTree

import numpy as np
import pytest
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from trajectory_msgs.msg import JointTrajectory
from visualization_msgs.msg import Marker, MarkerArray

from support.executor.client import Client
from support.harness import eventually
from support.ros.client import RosClient, one, reported
from support.ros.node import destroyed
from support.ros.stack import KEYS, Stack
from support.trajectories import HOME, ROBOT, moved, rest_to_rest
from zarm_contract import messages as m
from zarm_ros_bridge.description import shown_description
from zarm_runtime.session import open_client

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


@pytest.fixture
def ros(running: Stack) -> Iterator[RosClient]:
    yield running.ros
    for subscription in list(running.ros.node.subscriptions):  # each test listens to what it reads alone
        destroyed(running.ros.node, running.ros.node.destroy_subscription, subscription)


@pytest.fixture(scope="module")
def client(running: Stack) -> Client:
    return Client(running.bus, KEYS)


def _plan(client: Client, *distances: float) -> m.Plan:
    goal = m.JointGoal(kind="joints", position=tuple(moved(*distances).tolist()))
    return client.bus.call(KEYS.plan, m.PlanRequest(goal=goal, start=tuple(HOME.tolist())), timeout=30)


def test_every_plan_is_on_trajectory_and_replayed_by_the_ghost(client: Client, ros: RosClient) -> None:
    trajectories = ros.heard(JointTrajectory, "/trajectory")
    ghost = ros.heard(JointState, "/preview/joint_states")
    plans: list[m.Plan] = []
    message = reported(trajectories, lambda: plans.append(_plan(client, 0.5)), "the plan has come")
    plan = plans[-1]  # and every one before it: the same request
    assert list(message.joint_names) == list(plan.trajectory.joint_names)
    for point, at, position, velocity in zip(
        message.points, plan.trajectory.time, plan.trajectory.position, plan.trajectory.velocity, strict=True
    ):
        assert point.time_from_start.sec + point.time_from_start.nanosec * 1e-9 == pytest.approx(at, abs=1e-9)
        assert (list(point.positions), list(point.velocities)) == (list(position), list(velocity))
    eventually(
        lambda: ghost and np.allclose(ghost[-1].position, plan.trajectory.position[-1]),
        "the ghost is at the end of the plan",
    )
    assert list(ghost[-1].name) == list(ROBOT.descriptor.joints)


def test_the_robot_is_on_joint_states_under_every_strategy(client: Client, ros: RosClient) -> None:
    robot = ros.heard(JointState, "/joint_states")
    emulator = ros.heard(JointState, "/emulator/joint_states")
    client.ended(client.execute(rest_to_rest(moved(0.3))))
    eventually(lambda: robot and robot[-1].position[0] == pytest.approx(HOME[0] + 0.3), "the robot is there")
    eventually(lambda: emulator and emulator[-1].position[0] == pytest.approx(HOME[0] + 0.3), "the emulated robot too")
    assert any(any(state.velocity) for state in robot)

    def stamp(state: JointState) -> float:
        return float(state.header.stamp.sec + state.header.stamp.nanosec * 1e-9)

    stamps = [stamp(state) for state in robot]
    assert stamps == sorted(stamps)
    client.strategy("ghost")
    try:
        eventually(lambda: client.state().strategy == "ghost", "the ghost alone is active")
        seen = len(robot)
        eventually(lambda: len(robot) > seen + 5, "the robot is still told")
        begun, seen = stamp(robot[-1]), len(robot)
        eventually(lambda: len(robot) > seen + 20, "the robot is still told")
        assert all(stamp(state) <= begun for state in emulator)
    finally:
        client.strategy("emulator")


def test_joints_are_published_while_there_are_subscribers(running: Stack, ros: RosClient) -> None:
    with open_client(running.endpoint) as session:
        publisher = session.declare_publisher(KEYS.preview_joint_states)

        def received() -> bool:
            return bool(publisher.matching_status.matching)

        for _ in range(2):
            eventually(lambda: not received(), "nobody receives them")
            ghost: list[JointState] = []
            subscription = ros.node.create_subscription(JointState, "/preview/joint_states", ghost.append, 10)
            one(ghost, "the ghost is told")
            assert received()
            destroyed(ros.node, ros.node.destroy_subscription, subscription)


def test_the_scene_is_there_as_markers_for_whoever_comes_late(client: Client, ros: RosClient) -> None:
    objects = (
        m.Cuboid(kind="cuboid", name="table", position=(0.9, 0.0, -0.2), size=(0.4, 1.0, 0.1)),
        m.Sphere(kind="sphere", name="ball", position=(0.9, 0.0, 0.5), radius=0.1),
        m.Capsule(kind="capsule", name="pipe", position=(0.9, 0.5, 0.5), radius=0.05, length=0.3),
        m.Cylinder(kind="cylinder", name="can", position=(0.9, -0.5, 0.5), radius=0.05, length=0.2),
        m.Voxels(kind="voxels", name="bin", position=(-0.9, 0.0, 0.5), resolution=0.05, cells=((0, 0, 0), (1, 0, 2))),
    )
    edit = m.SceneEdit(edit=m.AddObjects(op="add", objects=objects))
    client.bus.call(KEYS.scene_edit, edit, timeout=30)
    shown = ros.heard(MarkerArray, "/unified_planner/obstacles", LATCHED)
    eventually(
        lambda: (
            shown
            and {marker.ns for marker in shown[-1].markers if marker.action == Marker.ADD} == {o.name for o in objects}
        ),
        "the scene is shown",
    )
    first, *markers = shown[-1].markers
    assert first.action == Marker.DELETEALL
    of = {name: [marker for marker in markers if marker.ns == name] for name in ("table", "ball", "pipe", "can", "bin")}
    assert {marker.header.frame_id for marker in markers} == {ROBOT.descriptor.base_link}
    (table,), (ball,), (can,), (bins,) = (of[name] for name in ("table", "ball", "can", "bin"))
    assert (table.type, table.scale.x, table.scale.y, table.scale.z) == (Marker.CUBE, 0.4, 1.0, 0.1)
    assert (ball.type, ball.scale.x, ball.pose.position.z) == (Marker.SPHERE, 0.2, 0.5)
    assert (can.type, can.scale.x, can.scale.z) == (Marker.CYLINDER, 0.1, 0.2)
    assert (bins.type, bins.scale.x, [(p.x, p.y, p.z) for p in bins.points]) == (
        Marker.CUBE_LIST,
        0.05,
        [(0, 0, 0), (0.05, 0, 0.1)],
    )
    assert [marker.type for marker in of["pipe"]] == [Marker.CYLINDER, Marker.SPHERE_LIST, Marker.SPHERE_LIST]
    client.bus.call(KEYS.scene_edit, m.SceneEdit(edit=m.ClearScene(op="clear")), timeout=30)
    eventually(lambda: len(shown[-1].markers) == 1, "nothing is shown any more")


def test_the_spheres_of_the_robot_are_in_the_frames_of_its_links(ros: RosClient) -> None:
    (marker, *others) = one(ros.heard(MarkerArray, "/unified_planner/collision_spheres", LATCHED), "spheres").markers
    spheres = [(link, sphere) for link, spheres in ROBOT.descriptor.spheres.items() for sphere in spheres]
    assert len(others) + 1 == len(spheres)
    link, sphere = spheres[0]
    assert marker.header.frame_id == link
    assert marker.scale.x == pytest.approx(2 * sphere.radius)
    assert (marker.pose.position.x, marker.pose.position.y, marker.pose.position.z) == sphere.center


@pytest.mark.parametrize("topic", ["/robot_description", "/preview/robot_description"])
def test_robot_description_is_latched_with_a_shape_per_link(ros: RosClient, topic: str) -> None:
    description = ElementTree.fromstring(one(ros.heard(String, topic, LATCHED), "the description").data)
    own = ElementTree.parse(ROBOT.urdf_path).getroot()
    assert [ElementTree.tostring(joint).split() for joint in description.iter("joint")] == [
        ElementTree.tostring(joint).split() for joint in own.iter("joint")
    ]
    assert {link.get("name") for link in description.iter("link") if link.find("visual") is not None} == set(
        ROBOT.descriptor.collision
    )


def test_a_capsule_is_shown_where_it_is() -> None:
    link, capsule = next(
        (link, part)
        for link, parts in ROBOT.descriptor.collision.items()
        for part in parts
        if part.kind == "capsule" and part.a[:2] != part.b[:2]
    )
    description = ElementTree.fromstring(shown_description(ROBOT))
    cylinders = [
        visual
        for visual in description.iterfind(f"link[@name='{link}']/visual")
        if visual.find("geometry/cylinder") is not None
    ]
    ends = set()
    for visual in cylinders:
        origin, cylinder = visual.find("origin"), visual.find("geometry/cylinder")
        middle = np.array([float(value) for value in origin.get("xyz").split()])
        _, pitch, yaw = (float(value) for value in origin.get("rpy").split())
        axis = np.array([np.sin(pitch) * np.cos(yaw), np.sin(pitch) * np.sin(yaw), np.cos(pitch)])
        half = float(cylinder.get("length")) / 2 * axis
        ends |= {tuple(np.round(end, 6)) for end in (middle - half, middle + half)}
    assert {tuple(np.round(capsule.a, 6)), tuple(np.round(capsule.b, 6))} <= ends
