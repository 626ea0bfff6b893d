"""The interface package holds what existing clients import, to the name of every field, and carries it over ROS."""

from __future__ import annotations

from typing import Any

import pytest
from action_msgs.msg import GoalStatus
from geometry_msgs.msg import Point, Pose
from rclpy.action import ActionClient, ActionServer
from rclpy.action.server import ServerGoalHandle
from rclpy.node import Node
from sensor_msgs.msg import JointState

from curobo_msgs import action, srv
from support.harness import eventually
from support.ros.node import answer, on_its_thread, running_node

Fields = dict[str, str]

ANSWER = {"success": "boolean", "message": "string"}
JOINTS, POSE = "sensor_msgs/JointState", "geometry_msgs/Pose"

SERVICES: dict[str, tuple[Fields, Fields]] = {
    "TrajectoryGeneration": (
        {
            "start_pose": JOINTS,
            "target_pose": POSE,
            "target_poses": f"sequence<{POSE}>",
            "target_joint_positions": "sequence<double>",
            "trajectory_constraints": "sequence<int8>",
            "trajectories_contraints": "sequence<int8>",
        },
        ANSWER | {"trajectory": f"sequence<{JOINTS}>", "dt": "double"},
    ),
    "SetPlanner": ({"planner_type": "uint8"}, ANSWER | {"previous_planner": "string", "current_planner": "string"}),
    "GetPlanners": (
        {},
        {
            "planner_names": "sequence<string>",
            "planner_ids": "sequence<uint8>",
            "current_planner_name": "string",
            "current_planner_id": "uint8",
            "success": "boolean",
        },
    ),
    "SetRobotStrategy": (
        {"robot_strategy": "string"},
        ANSWER | {"previous_robot_strategy": "string", "current_robot_strategy": "string"},
    ),
    "GetRobotStrategies": (
        {},
        {
            "strategy_names": "sequence<string>",
            "strategy_ids": "sequence<uint8>",
            "current_strategy_name": "string",
            "current_strategy_id": "uint8",
            "success": "boolean",
        },
    ),
    "AddObject": (
        {
            "type": "int8",
            "name": "string",
            "mesh_file_path": "string",
            "pose": POSE,
            "dimensions": "geometry_msgs/Vector3",
            "color": "std_msgs/ColorRGBA",
        },
        ANSWER,
    ),
    "RemoveObject": ({"name": "string"}, ANSWER),
    "GetCollisionDistance": ({}, {"data": "sequence<float>", "nb_sphere": "int8"}),
    "SetCollisionCache": (
        {"obb": "int32", "mesh": "int32", "blox": "int32"},
        ANSWER | {"obb_cache": "int32", "mesh_cache": "int32", "blox_cache": "int32"},
    ),
    "SetLinkCollision": (
        {"link_names": "sequence<string>", "enabled": "boolean"},
        ANSWER | {"applied_links": "sequence<string>", "unknown_links": "sequence<string>"},
    ),
    "SceneGenerator": ({"nb_object": "int8", "max_reach": "float"}, ANSWER),
    "GenerateRM": ({"resolution": "double", "batch_size": "int32"}, ANSWER),
    "Collisions": ({"collision_path": "string", "pose": POSE}, {"success": "boolean"}),
    "WarmupIK": ({"batch_size": "int32"}, ANSWER),
    "WarmupFK": ({"batch_size": "int32"}, ANSWER),
    "Ik": (
        {"pose": POSE},
        {
            "joint_states": JOINTS,
            "joint_states_valid": "std_msgs/Bool",
            "error_msg": "std_msgs/String",
            "success": "boolean",
        },
    ),
    "IkBatch": (
        {"poses": f"sequence<{POSE}>"},
        {
            "joint_states": f"sequence<{JOINTS}>",
            "joint_states_valid": "sequence<std_msgs/Bool>",
            "error_msg": "std_msgs/String",
            "success": "boolean",
        },
    ),
    "Fk": (
        {"joint_states": f"sequence<{JOINTS}>"},
        {
            "poses": f"sequence<{POSE}>",
            "joint_states_valid": "sequence<std_msgs/Bool>",
            "error_msg": "std_msgs/String",
        },
    ),
}

ACTIONS: dict[str, tuple[Fields, Fields, Fields]] = {
    "SendTrajectory": (
        {
            "start_pose": JOINTS,
            "target_pose": POSE,
            "target_poses": f"sequence<{POSE}>",
            "target_joint_positions": "sequence<double>",
            "allow_cached": "boolean",
        },
        ANSWER,
        {
            "state": "string",
            "step_progression": "float",
            "position_error": "double",
            "on_target": "boolean",
            "joint_command": JOINTS,
            "orientation_error": "double",
            "hold_count": "int32",
            "controller_position_error": "double",
            "controller_orientation_error": "double",
        },
    ),
    "DataGeneration": (
        {"resolution": "double", "batch_size": "int32"},
        ANSWER,
        {"batch_id": "int32", "batch_nb": "int32"},
    ),
    "MpcMove": ({"target_pose": POSE}, ANSWER, {"joint_command": JOINTS, "step_progression": "float"}),
}


def fields(message: Any) -> list[tuple[str, str]]:
    """The fields of a message in their order; one without any has one that ROS puts there."""
    found = message.get_fields_and_field_types()
    return [item for item in found.items() if item[0] != "structure_needs_at_least_one_member"]


def types(package: Any) -> set[str]:
    return {name for name, value in vars(package).items() if isinstance(value, type)}


def test_there_is_every_service_and_action_and_no_other() -> None:
    assert {name.partition("_")[0] for name in types(srv)} == set(SERVICES)
    assert {name.partition("_")[0] for name in types(action)} == set(ACTIONS)


@pytest.mark.parametrize("name", SERVICES)
def test_a_service_has_these_fields_in_this_order(name: str) -> None:
    request, response = SERVICES[name]
    assert fields(getattr(srv, name).Request) == list(request.items())
    assert fields(getattr(srv, name).Response) == list(response.items())


@pytest.mark.parametrize("name", ACTIONS)
def test_an_action_has_these_fields_in_this_order(name: str) -> None:
    kind = getattr(action, name)
    assert [fields(part) for part in (kind.Goal, kind.Result, kind.Feedback)] == [
        list(part.items()) for part in ACTIONS[name]
    ]


def test_planners_and_shapes_have_their_numbers() -> None:
    names = ("CLASSIC", "MPC", "BATCH", "CONSTRAINED", "MULTIPOINT", "JOINT_SPACE", "RETARGET")
    assert [getattr(srv.SetPlanner.Request, name) for name in names] == [0, 1, 2, 3, 4, 5, 6]
    shapes = ("CUBOID", "SPHERE", "CAPSULE", "CYLINDER", "MESH")
    assert [getattr(srv.AddObject.Request, name) for name in shapes] == [0, 1, 2, 3, 4]


def test_a_client_gets_what_the_server_of_a_service_answers(node: Node) -> None:
    asked = srv.TrajectoryGeneration.Request(
        start_pose=JointState(name=["joint_1"], position=[0.1]),
        target_pose=Pose(position=Point(x=0.5, y=0.2, z=0.3)),
        target_poses=[Pose(), Pose(position=Point(z=1.0))],
        target_joint_positions=[1.0, 2.0],
        trajectory_constraints=[1, 0, 0, 0, 0, 1],
        trajectories_contraints=[0] * 12,
    )
    answered = srv.TrajectoryGeneration.Response(
        success=True, message="planned", trajectory=[JointState(velocity=[0.5]), JointState()], dt=0.02
    )
    requests = []

    def serve(
        request: srv.TrajectoryGeneration.Request, _: srv.TrajectoryGeneration.Response
    ) -> srv.TrajectoryGeneration.Response:
        requests.append(request)
        return answered

    node.create_service(srv.TrajectoryGeneration, "generate_trajectory", serve)
    client = node.create_client(srv.TrajectoryGeneration, "generate_trajectory")
    eventually(client.service_is_ready, "the service is found")
    assert answer(client.call_async(asked), "the service answers") == answered
    assert requests == [asked]


def test_an_action_gives_feedback_and_a_result(node: Node) -> None:
    asked = action.SendTrajectory.Goal(target_pose=Pose(position=Point(x=0.5)))
    halfway = action.SendTrajectory.Feedback(
        state="executing", step_progression=0.5, joint_command=JointState(name=["joint_1"], position=[0.1])
    )
    ended = action.SendTrajectory.Result(success=True, message="done")
    report = []

    def execute(goal: ServerGoalHandle) -> action.SendTrajectory.Result:
        assert goal.request == asked
        goal.publish_feedback(halfway)
        eventually(lambda: report, "the client has the feedback")
        goal.succeed()
        return ended

    with running_node("server") as server:
        ActionServer(server, action.SendTrajectory, "execute_trajectory", execute)
        client = ActionClient(node, action.SendTrajectory, "execute_trajectory")
        eventually(client.server_is_ready, "the action is found")
        sent = on_its_thread(node, lambda: client.send_goal_async(asked, report.append))
        goal = answer(sent, "the goal is accepted")
        result = answer(on_its_thread(node, goal.get_result_async), "the goal ends")
    assert (result.status, result.result) == (GoalStatus.STATUS_SUCCEEDED, ended)
    assert [message.feedback for message in report] == [halfway]
