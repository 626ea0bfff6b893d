"""pymoveit2 as it is on PyPI, against a bridge with --moveit."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from pymoveit2 import MoveIt2
from pymoveit2.robot_description import RobotDescription
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.node import Node

from support.harness import PATIENCE, eventually
from support.ros.node import answer, served
from support.ros.stack import KEYS, Stack
from zarm.connection import Connection
from zarm.robot import Robot
from zarm_contract.robot import load_robot

ROBOT = load_robot("doosan_m1013")
JOINTS, HOME = ROBOT.descriptor.joints, ROBOT.descriptor.home
DOWN = (1.0, 0.0, 0.0, 0.0)
AT = (0.55, 0.2, 0.4)


@pytest.fixture
def moveit(arm: Stack, client: Node, group: ReentrantCallbackGroup) -> MoveIt2:
    """The client as its users make it, from the descriptions that move_group has."""
    described = RobotDescription.from_node(client, timeout_sec=PATIENCE)
    return MoveIt2(node=client, callback_group=group, **described.moveit2_kwargs())


@pytest.fixture
def robot(arm: Stack) -> Robot:
    """The same robot on the bus."""
    return Robot(Connection.of(arm.bus, KEYS))


def test_the_descriptions_name_the_arm(arm: Stack, client: Node) -> None:
    described = RobotDescription.from_node(client, timeout_sec=PATIENCE)
    group = described.group("arm")
    assert described.group_names == ["arm"]
    assert tuple(group.movable_joint_names) == JOINTS
    assert described.joint_positions("home") == pytest.approx(HOME)


def test_a_pose_is_planned_and_executed(moveit: MoveIt2, robot: Robot) -> None:
    moveit.move_to_pose(position=AT, quat_xyzw=DOWN)
    assert moveit.wait_until_executed(), moveit.last_failure()
    tip = robot.tip()
    assert np.allclose(tip.position, AT, atol=1e-3)
    assert abs(np.dot(tip.orientation, DOWN)) > 1 - 1e-6


def test_joints_are_planned_and_executed(moveit: MoveIt2, robot: Robot) -> None:
    moveit.move_to_configuration(list(HOME))
    assert moveit.wait_until_executed(), moveit.last_failure()
    assert np.allclose(robot.joint_state().position, HOME, atol=1e-3)


def test_move_action_plans_and_executes(arm: Stack, client: Node, group: ReentrantCallbackGroup, robot: Robot) -> None:
    served(client, "move_action")

    def moved() -> bool:
        """rclpy's client of actions loses an answer that comes while it still sends."""
        moveit = MoveIt2(
            node=client,
            callback_group=group,
            joint_names=list(JOINTS),
            base_link_name="base_link",
            end_effector_name="link_6",
            group_name="arm",
            use_move_group_action=True,
        )
        moveit.move_to_pose(position=(0.5, -0.2, 0.5), quat_xyzw=DOWN)
        return bool(moveit.wait_until_executed(timeout_sec=PATIENCE / 4))

    eventually(moved, "the robot has moved")
    assert np.allclose(robot.tip().position, (0.5, -0.2, 0.5), atol=1e-3)


def test_a_cartesian_path_is_straight(moveit: MoveIt2, robot: Robot) -> None:
    moveit.move_to_pose(position=AT, quat_xyzw=DOWN)
    assert moveit.wait_until_executed(), moveit.last_failure()
    to = (AT[0], AT[1] - 0.3, AT[2])
    trajectory = moveit.plan(position=to, quat_xyzw=DOWN, cartesian=True, cartesian_fraction_threshold=1.0)
    assert trajectory is not None, moveit.last_failure()
    tips = np.array([pose.position for pose in robot.fk([list(point.positions) for point in trajectory.points])])
    assert np.allclose(tips[:, 0], AT[0], atol=1e-4)
    assert np.allclose(tips[:, 2], AT[2], atol=1e-4)
    moveit.execute(trajectory)
    assert moveit.wait_until_executed(), moveit.last_failure()
    assert np.allclose(robot.tip().position, to, atol=1e-3)


def test_a_target_out_of_reach_has_no_plan(moveit: MoveIt2) -> None:
    assert moveit.plan(position=(3.0, 0.0, 0.5), quat_xyzw=DOWN) is None


def test_forward_and_inverse_kinematics_agree(moveit: MoveIt2) -> None:
    pose = moveit.compute_fk(joint_state=list(HOME), timeout_sec=PATIENCE)
    p, q = pose.pose.position, pose.pose.orientation
    state = moveit.compute_ik((p.x, p.y, p.z), (q.x, q.y, q.z, q.w), start_joint_state=list(HOME), timeout_sec=PATIENCE)
    assert list(state.name) == list(JOINTS)
    assert np.allclose(state.position, HOME, atol=1e-3)


def test_every_shape_is_added_moved_and_removed(moveit: MoveIt2, robot: Robot) -> None:
    moveit.add_collision_box("box", (0.1, 0.2, 0.3), position=(0.8, 0.6, 0.2), quat_xyzw=(0.0, 0.0, 0.0, 1.0))
    moveit.add_collision_sphere("ball", 0.1, position=(0.8, -0.6, 0.2))
    moveit.add_collision_cylinder("post", 0.4, 0.05, position=(-0.8, 0.6, 0.2), quat_xyzw=(0.0, 0.0, 0.0, 1.0))
    moveit.add_collision_cone("cone", 0.4, 0.05, position=(-0.8, -0.6, 0.2), quat_xyzw=(0.0, 0.0, 0.0, 1.0))
    eventually(lambda: set(robot.scene.objects()) == {"box", "ball", "post", "cone"}, "all are in the scene")
    assert robot.scene.objects()["box"].size == (0.1, 0.2, 0.3)
    moveit.move_collision("box", (0.9, 0.6, 0.2), (0.0, 0.0, 0.0, 1.0))
    eventually(lambda: robot.scene.objects()["box"].position == pytest.approx((0.9, 0.6, 0.2)), "it is moved")
    moveit.remove_collision_object("box")
    eventually(lambda: "box" not in robot.scene.objects(), "it is gone")
    assert moveit.update_planning_scene(timeout_sec=PATIENCE)
    assert {item.id for item in moveit.planning_scene.world.collision_objects} == {"ball", "post", "cone"}
    assert answer(moveit.clear_all_collision_objects(timeout_sec=PATIENCE), "all are removed").success
    eventually(lambda: not robot.scene.objects(), "the scene is empty")


def test_a_mesh_is_an_obstacle_and_comes_back_as_it_was(moveit: MoveIt2, robot: Robot) -> None:
    there = {"position": (0.3, -0.6, 0.4), "quat_xyzw": DOWN}
    block = trimesh.creation.box((0.2, 0.2, 0.2))
    moveit.add_collision_mesh(None, "block", mesh=block, **there)
    eventually(lambda: "block" in robot.scene.objects(), "it is in the scene")
    assert moveit.plan(**there) is None
    assert moveit.update_planning_scene(timeout_sec=PATIENCE)
    (item,) = moveit.planning_scene.world.collision_objects
    assert (len(item.meshes[0].vertices), len(item.meshes[0].triangles)) == (8, 12)
    assert item.pose.position.y == pytest.approx(-0.6)
    moveit.remove_collision_object("block")
    eventually(lambda: "block" not in robot.scene.objects(), "it is gone")


def test_an_object_is_attached_and_detached(moveit: MoveIt2, robot: Robot) -> None:
    x, y, z = robot.tip().position
    moveit.add_collision_box("part", (0.04, 0.04, 0.04), position=(x, y, z - 0.1), quat_xyzw=DOWN)
    eventually(lambda: "part" in robot.scene.objects(), "it is in the scene")
    moveit.attach_collision_object("part", "link_6", touch_links=["link_5"])
    eventually(lambda: "part" in robot.scene.attached(), "it is carried")
    moveit.detach_all_collision_objects()
    eventually(lambda: "part" in robot.scene.objects(), "it is back in the scene")
    moveit.remove_collision_object("part")
    eventually(lambda: "part" not in robot.scene.objects(), "it is gone")


def test_an_object_that_may_be_touched_is_no_obstacle(moveit: MoveIt2, robot: Robot) -> None:
    there = {"position": (0.3, -0.6, 0.4), "quat_xyzw": DOWN}
    moveit.add_collision_box("curtain", (0.2, 0.2, 0.2), **there)
    eventually(lambda: "curtain" in robot.scene.objects(), "it is in the scene")
    assert moveit.plan(**there) is None
    assert answer(moveit.allow_collisions("curtain", True, timeout_sec=PATIENCE), "it is applied").success
    assert moveit.plan(**there) is not None, moveit.last_failure()
    assert answer(moveit.allow_collisions("curtain", False, timeout_sec=PATIENCE), "it is applied").success
    assert moveit.plan(**there) is None
    moveit.remove_collision_object("curtain")
    eventually(lambda: "curtain" not in robot.scene.objects(), "it is gone")


def test_a_motion_is_stopped_by_the_event(moveit: MoveIt2, robot: Robot) -> None:
    robot.executor.speed(0.2)
    try:
        moveit.move_to_configuration([HOME[0] + 1.0, *HOME[1:]])
        eventually(lambda: robot.state().goal_id is not None, "it moves")
        moveit.stop_all_trajectory_execution()
        assert not moveit.wait_until_executed()
        eventually(lambda: robot.state().goal_id is None, "it rests")
    finally:
        robot.executor.speed(1.0)


def test_a_motion_is_cancelled(moveit: MoveIt2, robot: Robot) -> None:
    robot.executor.speed(0.2)
    try:
        moveit.move_to_configuration([HOME[0] - 1.0, *HOME[1:]])
        eventually(lambda: robot.state().goal_id is not None, "it moves")
        moveit.cancel_execution()
        assert not moveit.wait_until_executed()
        eventually(lambda: robot.state().goal_id is None, "it rests")
    finally:
        robot.executor.speed(1.0)
