"""Whatever a client asks for, it is answered with a sentence, and the bridge stays the same process, unharmed."""

from __future__ import annotations

import math
import random
from collections.abc import Iterator
from typing import Any

import pytest
from geometry_msgs.msg import Pose, Vector3
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import SetParameters
from sensor_msgs.msg import JointState
from std_msgs.msg import ColorRGBA

from curobo_msgs import srv
from curobo_msgs.action import MpcMove
from support.harness import PATIENCE
from support.resources import burden
from support.ros.damage import NUMBERS, damaged
from support.ros.goals import ABORTED, HOME, TARGET, Actions
from support.ros.node import answer
from support.ros.stack import Stack
from zarm_contract.robot import load_robot

COUNT = 60
"""Damaged requests for each service."""
LONGEST = 2500
"""Characters of the longest message of a refusal."""
JOINTS = list(load_robot("doosan_m1013").descriptor.joints)
THERE = JointState(name=JOINTS, position=list(HOME), velocity=[0.0] * 6, effort=[0.0] * 6)

GOOD: dict[str, tuple[Any, Any]] = {
    "generate_trajectory": (
        srv.TrajectoryGeneration,
        srv.TrajectoryGeneration.Request(
            start_pose=THERE,
            target_pose=TARGET,
            target_poses=[TARGET] * 2,
            target_joint_positions=list(HOME),
            trajectory_constraints=[0] * 6,
            trajectories_contraints=[0] * 12,
        ),
    ),
    "set_planner": (srv.SetPlanner, srv.SetPlanner.Request(planner_type=7)),
    "ik": (srv.Ik, srv.Ik.Request(pose=TARGET)),
    "ik_batch": (srv.IkBatch, srv.IkBatch.Request(poses=[TARGET] * 3)),
    "fk": (srv.Fk, srv.Fk.Request(joint_states=[THERE] * 3)),
    "warmup_ik": (srv.WarmupIK, srv.WarmupIK.Request(batch_size=1)),
    "warmup_fk": (srv.WarmupFK, srv.WarmupFK.Request(batch_size=1)),
    "add_object": (
        srv.AddObject,
        srv.AddObject.Request(
            name="box", pose=TARGET, dimensions=Vector3(x=0.1, y=0.1, z=0.1), color=ColorRGBA(r=1.0, a=1.0)
        ),
    ),
    "remove_object": (srv.RemoveObject, srv.RemoveObject.Request(name="box")),
    "set_collision_cache": (srv.SetCollisionCache, srv.SetCollisionCache.Request(obb=1, mesh=1, blox=1)),
    "set_link_collision": (
        srv.SetLinkCollision,
        srv.SetLinkCollision.Request(link_names=["link_6", "link_5", "nothing"], enabled=True),
    ),
    "set_robot_strategy": (srv.SetRobotStrategy, srv.SetRobotStrategy.Request(robot_strategy="none")),
}

LARGE: dict[str, tuple[str, dict[str, Any], str]] = {
    "10,000 target_poses": (
        "generate_trajectory",
        {"target_poses": [TARGET] * 10_000},
        "10000 poses are more than 100",
    ),
    "100,000 target_joint_positions": (
        "generate_trajectory",
        {"target_joint_positions": [0.0] * 100_000},
        "100000 positions for the 6 joints",
    ),
    "100,000 constraints": (
        "generate_trajectory",
        {"target_pose": TARGET, "trajectory_constraints": [0] * 99_996},
        "99996 constraints; give six",
    ),
    "a start of 10,000 other joints": (
        "generate_trajectory",
        {
            "target_pose": TARGET,
            "start_pose": JointState(name=[f"j{i}" for i in range(10_000)], position=[0.0] * 10_000),
        },
        "name each of joint_1",
    ),
    "5,000 joint states": ("fk", {"joint_states": [THERE] * 5_000}, "5000 is outside 1 to 1000"),
    "5,000 poses": ("ik_batch", {"poses": [TARGET] * 5_000}, "5000 is outside 1 to 1000"),
    "a warm-up of 2^31 - 1": ("warmup_ik", {"batch_size": 2**31 - 1}, "is outside 1 to 1000"),
    "a name of a million": ("add_object", {"name": "x" * 10**6}, "a name is 1 to 64 letters"),
    "a path of a million": (
        "add_object",
        {"name": "m", "type": srv.AddObject.Request.MESH, "mesh_file_path": "x" * 10**6},
        "1 to 255 characters",
    ),
    "a strategy of a million": ("set_robot_strategy", {"robot_strategy": "x" * 10**6}, "this robot has"),
    "10,000 links": ("set_link_collision", {"link_names": [f"link {i}" for i in range(10_000)]}, "choose among"),
}


@pytest.fixture(autouse=True)
def unharmed(running: Stack) -> Iterator[None]:
    bridge = running.processes["ros_bridge"]
    before = burden(bridge)
    yield
    for process in running.processes.values():
        assert "Traceback" not in process.output(), process.output()
        assert process.process.poll() is None, process.output()
    assert burden(bridge).descriptors <= before.descriptors + 2
    plan = running.ros.call(
        srv.TrajectoryGeneration, "generate_trajectory", start_pose=THERE, target_joint_positions=[0.3, *HOME[1:]]
    )
    assert plan.success, plan.message


def report(response: Any) -> tuple[bool, str]:
    """Whether it went well, and what went wrong."""
    message = response.error_msg.data if hasattr(response, "error_msg") else response.message
    return (response.success if hasattr(response, "success") else not message), message


@pytest.mark.parametrize("what", LARGE)
def test_requests_beyond_the_limits_are_refused_with_the_limit(running: Stack, what: str) -> None:
    name, request, reason = LARGE[what]
    success, message = report(running.ros.call(GOOD[name][0], name, **request))
    assert not success
    assert reason in message
    assert len(message) < LONGEST


@pytest.mark.slow
@pytest.mark.parametrize("name", GOOD)
def test_every_service_answers_damaged_requests_with_a_sentence(running: Stack, name: str) -> None:
    kind, good = GOOD[name]
    chance = random.Random(name)
    fields = kind.Request.get_fields_and_field_types()
    for _ in range(COUNT):
        request = damaged(good, chance, chance.choice((0.05, 0.3)))
        response = running.ros.call(kind, name, **{field: getattr(request, field) for field in fields})
        success, message = report(response)
        assert success or message, request
        assert len(message) < LONGEST
        assert "the ROS bridge failed" not in message, request


def test_parameters_that_cannot_be_are_refused_with_the_reason(running: Stack) -> None:
    client = running.ros.node.create_client(SetParameters, "/unified_planner/set_parameters")
    assert client.wait_for_service(PATIENCE)
    values = [ParameterValue(type=ParameterType.PARAMETER_NOT_SET)]
    values += [
        ParameterValue(type=ParameterType.PARAMETER_DOUBLE, double_value=v) for v in (math.nan, math.inf, -1e308)
    ]
    values += [ParameterValue(type=ParameterType.PARAMETER_INTEGER, integer_value=v) for v in (-(2**63), 2**63 - 1)]
    values += [ParameterValue(type=ParameterType.PARAMETER_STRING, string_value=v) for v in ("\u202e", "x" * 10**5)]
    values += [ParameterValue(type=ParameterType.PARAMETER_DOUBLE_ARRAY, double_array_value=[math.nan] * 1000)]
    values += [ParameterValue(type=77)]
    names = ("timeout", "max_attempts", "planner_type", "control_strategy", "robot_type", "world_file", "voxel_size")
    for name in (*names, "preempt", "robot", "mpc_horizon", "no_such_parameter"):
        for value in values:
            request = SetParameters.Request(parameters=[Parameter(name=name, value=value)])
            (result,) = answer(client.call_async(request), f"{name} is answered").results
            assert not result.successful, (name, value)
            assert result.reason, (name, value)
            assert len(result.reason) < LONGEST


def test_goals_without_a_valid_target_are_aborted_by_field(running: Stack) -> None:
    chance = random.Random(1)
    actions, closed = Actions(running.ros.node), Actions(running.ros.node, "mpc_move", MpcMove)
    for number in NUMBERS[:3]:
        for axis in "xyz":
            pose = Pose()
            setattr(pose.position, axis, number)
            status, result = actions.send(target_pose=pose).ended()
            assert status == ABORTED
            assert f"(target_pose.position.{axis})" in result.message
    for _ in range(10):
        assert closed.send(target_pose=damaged(TARGET, chance, 0.3)).ended()[0] == ABORTED
