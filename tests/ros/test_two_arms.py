"""Two arms for clients of MoveIt: a group for each, as in a robot that MoveIt's setup assistant described."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterator

import numpy as np
import pytest
from geometry_msgs.msg import Point, PoseStamped, Quaternion
from geometry_msgs.msg import Pose as RosPose
from moveit_msgs.msg import Constraints, MotionPlanResponse, MoveItErrorCodes
from moveit_msgs.srv import GetMotionPlan, GetPositionIK
from pymoveit2 import MoveIt2
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.node import Node

import zarm
from support.composed import two_pandas
from support.harness import PATIENCE, eventually
from support.ros.moveit import DOWN, SUCCESS, pose, request
from support.ros.node import answer, served, spinning
from support.ros.stack import Stack, stack
from zarm.robot import Robot
from zarm_contract.robot import RobotDescription, load_robot
from zarm_ros_bridge.moveit.srdf import semantic_description

TIP = "{}_panda_grasptarget"


@pytest.fixture(scope="module")
def pandas(tmp_path_factory: pytest.TempPathFactory) -> RobotDescription:
    return load_robot(str(two_pandas(tmp_path_factory.mktemp("pandas"))))


@pytest.fixture(scope="module")
def arms(pandas: RobotDescription, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Stack]:
    """Two emulated Pandas on one table, whose bridge serves MoveIt's interface."""
    folder = tmp_path_factory.mktemp("stack")
    with stack(folder, robot=str(pandas.path), ros_bridge=("--moveit",), servo=()) as processes:
        yield processes


@pytest.fixture(scope="module")
def robot(arms: Stack) -> Iterator[Robot]:
    with zarm.connect(arms.endpoint, "arm") as robot:
        yield robot


@pytest.fixture
def client() -> Iterator[Node]:
    with spinning("two_arms_client") as node:
        yield node


def moveit(client: Node, pandas: RobotDescription, group: str) -> MoveIt2:
    made = MoveIt2(
        node=client,
        joint_names=list(pandas.group_joints(group)),
        base_link_name="table",
        end_effector_name=TIP.format(group),
        group_name=group,
        callback_group=ReentrantCallbackGroup(),
    )
    served(client, "move_action", "execute_trajectory")
    return made


def test_each_arm_is_planned_and_executed_by_its_group(
    client: Node, pandas: RobotDescription, arms: Stack, robot: Robot
) -> None:
    for group, y in (("left", 0.25), ("right", -0.25)):
        arm = moveit(client, pandas, group)
        other = [name not in arm.joint_names for name in pandas.descriptor.joints]
        before = np.array(robot.joint_state().position)
        arm.move_to_pose(position=(0.45, y, 0.4), quat_xyzw=DOWN)
        assert arm.wait_until_executed()
        assert robot.tip(group).position == pytest.approx((0.45, y, 0.4), abs=2e-3)
        assert np.array(robot.joint_state().position)[other] == pytest.approx(before[other], abs=1e-9)


def test_joints_of_a_group_are_a_goal(client: Node, pandas: RobotDescription, arms: Stack, robot: Robot) -> None:
    goal = np.array(pandas.group("right").descriptor.home) + 0.1
    arm = moveit(client, pandas, "right")
    arm.move_to_configuration(goal.tolist())
    assert arm.wait_until_executed()
    assert robot.joint_state().position[7:] == pytest.approx(goal, abs=1e-3)


def test_poses_of_both_tips_are_one_goal(client: Node, pandas: RobotDescription, arms: Stack, robot: Robot) -> None:
    """As `setPoseTarget` for the tip of each arm makes it."""
    served(client, "move_action")
    ask = client.create_client(GetMotionPlan, "/plan_kinematic_path")
    assert ask.wait_for_service(PATIENCE)

    def planned(*goals: Constraints) -> MotionPlanResponse:
        message = GetMotionPlan.Request(motion_plan_request=request(*goals))
        return answer(ask.call_async(message), "it is planned").motion_plan_response

    wanted = {"left": (0.5, 0.2, 0.45), "right": (0.5, -0.2, 0.35)}
    both = Constraints()
    for name, at in wanted.items():
        one = pose(at, DOWN, TIP.format(name), frame="table")
        both.position_constraints += one.position_constraints
        both.orientation_constraints += one.orientation_constraints
    found = planned(both)
    assert found.error_code.val == SUCCESS
    points = found.trajectory.joint_trajectory
    end = dict(zip(points.joint_names, points.points[-1].positions, strict=True))
    for name, at in wanted.items():
        q = [end[joint] for joint in pandas.descriptor.joints]
        assert robot.fk([q], group=name)[0].position == pytest.approx(at, abs=2e-3)
    refused = planned(pose((0.5, 0.0, 0.4), DOWN, "table", frame="table"))
    assert refused.error_code.val == MoveItErrorCodes.INVALID_LINK_NAME


def test_inverse_kinematics_of_a_group_keep_the_other_arm(
    client: Node, pandas: RobotDescription, arms: Stack, robot: Robot
) -> None:
    arm = moveit(client, pandas, "right")
    found = arm.compute_ik(position=(0.4, -0.2, 0.5), quat_xyzw=DOWN)
    assert found is not None
    q = [dict(zip(found.name, found.position, strict=True))[name] for name in pandas.descriptor.joints]
    assert robot.fk([q], group="right")[0].position == pytest.approx((0.4, -0.2, 0.5), abs=1e-4)
    assert q[:7] == pytest.approx(robot.joint_state().position[:7], abs=1e-9)


def test_inverse_kinematics_of_both_arms_go_together(
    client: Node, pandas: RobotDescription, arms: Stack, robot: Robot
) -> None:
    ask = client.create_client(GetPositionIK, "/compute_ik")
    assert ask.wait_for_service(PATIENCE)
    wanted = {"left": (0.5, 0.13, 0.5), "right": (0.5, -0.13, 0.4)}

    def asked(names: list[str]) -> GetPositionIK.Response:
        message = GetPositionIK.Request()
        message.ik_request.group_name = "arm"
        message.ik_request.avoid_collisions = True
        message.ik_request.ik_link_names = names
        for at in wanted.values():
            stamped = PoseStamped(
                pose=RosPose(position=Point(**dict(zip("xyz", at, strict=True))), orientation=Quaternion(x=1.0, w=0.0))
            )
            stamped.header.frame_id = "table"
            message.ik_request.pose_stamped_vector.append(stamped)
        return answer(ask.call_async(message), "it is solved")

    found = asked([TIP.format(name) for name in wanted])
    assert found.error_code.val == SUCCESS
    state = found.solution.joint_state
    joints = dict(zip(state.name, state.position, strict=True))
    q = [joints[name] for name in pandas.descriptor.joints]
    for name, at in wanted.items():
        assert robot.fk([q], group=name)[0].position == pytest.approx(at, abs=1e-4)
    (result,) = robot.check([q])
    assert not result.in_collision
    for names in ([TIP.format("left")], [TIP.format("left"), "left_panda_hand"]):
        assert asked(names).error_code.val == MoveItErrorCodes.INVALID_GOAL_CONSTRAINTS


def test_an_object_is_attached_to_the_arm_that_is_named(
    client: Node, pandas: RobotDescription, arms: Stack, robot: Robot
) -> None:
    arm = moveit(client, pandas, "right")
    x, y, z = robot.tip("right").position
    topics = ("/collision_object", "/attached_collision_object")
    eventually(lambda: all(map(client.count_subscribers, topics)), "the bridge listens")
    arm.add_collision_box("part", size=(0.03, 0.03, 0.03), position=(x, y, z), quat_xyzw=(0.0, 0.0, 0.0, 1.0))
    eventually(lambda: "part" in robot.scene.objects(), "it is in the scene")
    fingers = [f"right_panda_{name}" for name in ("hand", "leftfinger", "rightfinger")]
    arm.attach_collision_object("part", "right_panda_hand", fingers)
    eventually_attached(robot, "right_panda_hand")
    arm.detach_all_collision_objects()
    robot.scene.clear()


def eventually_attached(robot: Robot, link: str) -> None:
    eventually(lambda: [one.link for one in robot.scene.read().attached] == [link], f"it is attached to {link}")


def test_the_semantic_description_has_a_group_for_each_arm(pandas: RobotDescription) -> None:
    root = ET.fromstring(semantic_description(pandas, "arm"))
    chains = {
        group.get("name"): (chain.get("base_link"), chain.get("tip_link"))
        for group in root.findall("group")
        for chain in group.findall("chain")
    }
    assert chains == {name: (f"{name}_panda_link0", TIP.format(name)) for name in ("left", "right")}
    (whole,) = (group for group in root.findall("group") if group.get("name") == "arm")
    assert tuple(joint.get("name") for joint in whole) == pandas.descriptor.joints
    parents = {one.get("name"): one.get("parent_group") for one in root.findall("end_effector")}
    assert parents == {"left_hand": "left", "right_hand": "right"}
