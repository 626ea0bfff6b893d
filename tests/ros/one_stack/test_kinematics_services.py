"""Kinematics by services of ROS: against a planner and a bridge that run, with plain types."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from geometry_msgs.msg import Point, Pose, Quaternion, Vector3
from sensor_msgs.msg import JointState

from curobo_msgs.srv import AddObject, Fk, Ik, IkBatch, RemoveObject, WarmupFK, WarmupIK
from support.planner.second_opinion import tip_error
from support.ros.stack import Stack
from zarm_contract.robot import load_robot

ROBOT = load_robot("doosan_m1013")
JOINTS, HOME = ROBOT.descriptor.joints, ROBOT.descriptor.home
FAR = Pose(position=Point(x=3.0))


def down(x: float, y: float, z: float) -> Pose:
    return Pose(position=Point(x=x, y=y, z=z), orientation=Quaternion(x=1.0, y=0.0, z=0.0, w=0.0))


def assert_there(joints: Any, pose: Pose) -> None:
    """An independent chain of the URDF's joints puts the tip at the pose."""
    p, q = pose.position, pose.orientation
    off = tip_error(ROBOT, tuple(joints), (p.x, p.y, p.z), (q.x, q.y, q.z, q.w))
    assert off == pytest.approx((0.0, 0.0), abs=1e-5)


def test_inverse_kinematics_name_joints_that_bring_the_tip_there(running: Stack) -> None:
    pose = down(0.5, 0.2, 0.3)
    response = running.ros.call(Ik, "ik", pose=pose)
    assert (response.success, response.joint_states_valid.data, response.error_msg.data) == (True, True, "")
    assert tuple(response.joint_states.name) == JOINTS
    assert_there(response.joint_states.position, pose)


def test_a_pose_out_of_reach_has_no_joints(running: Stack) -> None:
    response = running.ros.call(Ik, "ik", pose=FAR)
    assert (response.success, response.joint_states_valid.data) == (False, False)
    assert not response.joint_states.position
    assert "cannot be reached" in response.error_msg.data


def test_joints_in_an_obstacle_are_no_solution(running: Stack) -> None:
    pose = down(0.5, 0.2, 0.3)
    ball = {"type": AddObject.Request.SPHERE, "name": "ball", "pose": pose, "dimensions": Vector3(x=0.1)}
    assert running.ros.call(AddObject, "add_object", **ball).success
    assert not running.ros.call(Ik, "ik", pose=pose).success
    assert running.ros.call(RemoveObject, "remove_object", name="ball").success
    assert running.ros.call(Ik, "ik", pose=pose).success


def test_of_a_batch_every_pose_has_its_answer_in_its_place(running: Stack) -> None:
    poses = [down(0.5, 0.2, 0.3), FAR, down(0.4, -0.3, 0.5)]
    response = running.ros.call(IkBatch, "ik_batch", poses=poses)
    assert [valid.data for valid in response.joint_states_valid] == [True, False, True]
    assert not response.success
    assert "1 of 3" in response.error_msg.data
    assert response.error_msg.data.endswith("(poses[1])")
    for place in (0, 2):
        assert_there(response.joint_states[place].position, poses[place])
    assert not response.joint_states[1].position
    whole = running.ros.call(IkBatch, "ik_batch", poses=[poses[0]] * 200)
    assert whole.success
    assert len(whole.joint_states) == 200


@pytest.mark.parametrize(
    ("poses", "field"),
    [
        ([], "poses"),
        ([FAR] * 1001, "poses"),
        ([FAR, Pose(position=Point(y=math.nan))], "poses[1].position.y"),
        ([Pose(orientation=Quaternion(x=2.0, w=0.0))], "poses[0].orientation"),
    ],
)
def test_a_batch_that_cannot_be_read_is_refused_with_the_field(running: Stack, poses: list[Pose], field: str) -> None:
    response = running.ros.call(IkBatch, "ik_batch", poses=poses)
    assert not response.success
    assert response.error_msg.data.endswith(f"({field})")
    assert not response.joint_states


def test_forward_kinematics_read_joints_by_name_and_by_order(running: Stack) -> None:
    joints = [HOME, (0.4, -0.2, 1.2, 0.3, 0.9, -0.5)]
    states = [JointState(name=JOINTS[::-1], position=q[::-1]) for q in joints]
    states += [JointState(position=q) for q in joints]
    response = running.ros.call(Fk, "fk", joint_states=states)
    assert all(valid.data for valid in response.joint_states_valid)
    assert response.error_msg.data == ""
    for q, pose in zip(joints * 2, response.poses, strict=True):
        assert_there(q, pose)


def test_invalid_fk_requests_are_marked_and_others_answered(running: Stack) -> None:
    beyond = (0.0, 0.0, 3.0, 0.0, 0.0, 0.0)
    states = [
        JointState(position=HOME),
        JointState(position=[0.0] * 5),
        JointState(position=beyond),
        JointState(name=["x", *JOINTS[1:]], position=HOME),
        JointState(position=[math.nan, *HOME[1:]]),
    ]
    response = running.ros.call(Fk, "fk", joint_states=states)
    assert [valid.data for valid in response.joint_states_valid] == [True, False, False, False, False]
    assert response.error_msg.data.endswith("(joint_states[1].position)")
    assert_there(HOME, response.poses[0])
    assert_there(beyond, response.poses[2])
    assert len(response.poses) == 5
    assert running.ros.call(Fk, "fk", joint_states=[]).error_msg.data.endswith("(joint_states)")


def test_kinematics_go_there_and_back(running: Stack) -> None:
    random = np.random.default_rng(0)
    poses = [down(*at) for at in random.uniform((0.3, -0.4, 0.3), (0.6, 0.4, 0.7), (20, 3)).tolist()]
    solved = running.ros.call(IkBatch, "ik_batch", poses=poses)
    assert solved.success, solved.error_msg.data
    there = running.ros.call(Fk, "fk", joint_states=solved.joint_states).poses
    for asked, found in zip(poses, there, strict=True):
        for axis in "xyz":
            assert getattr(found.position, axis) == pytest.approx(getattr(asked.position, axis), abs=1e-5)


@pytest.mark.parametrize(("kind", "name"), [(WarmupIK, "warmup_ik"), (WarmupFK, "warmup_fk")])
def test_a_warm_up_runs_a_batch_of_its_size(running: Stack, kind: Any, name: str) -> None:
    response = running.ros.call(kind, name, batch_size=100)
    assert response.success
    assert "of 100 " in response.message
    for size in (0, -3, 1001):
        refused = running.ros.call(kind, name, batch_size=size)
        assert not refused.success
        assert refused.message.endswith("(batch_size)")
