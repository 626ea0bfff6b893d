"""Clients with each generation of curobo_msgs: every service and action of each, with classes of that package, in a process of its own."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack
from typing import Any

import pytest
from action_msgs.msg import GoalStatus

from support.harness import ServiceProcess, eventually, router
from support.ros.generations import Typed, typed
from support.ros.stack import KEYS
from zarm_contract.robot import load_robot
from zarm_ros_bridge.curobo.generations import installed
from zarm_ros_bridge.curobo.generations.definitions import definitions
from zarm_runtime.bus import Bus

ROBOT = load_robot("doosan_m1013")
HOME = list(ROBOT.descriptor.home)
SPHERES = sum(map(len, ROBOT.descriptor.spheres.values()))
DOWN = {"x": 0.0, "y": 1.0, "z": 0.0, "w": 0.0}
TRIGGER = "std_srvs/srv/Trigger"


def pose(x: float, y: float, z: float) -> dict[str, Any]:
    return {"position": {"x": x, "y": y, "z": z}, "orientation": DOWN}


NEAR, FAR, NOWHERE = pose(0.5, 0.2, 0.4), pose(-0.5, -0.3, 0.4), pose(9.0, 0.0, 0.4)


@pytest.fixture(scope="module")
def endpoint(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """A planner, an executor and a servo, which know nothing of generations."""
    with ExitStack() as started:
        address = started.enter_context(router())
        bus = started.enter_context(Bus(address))
        folder = tmp_path_factory.mktemp("arm")
        services = [
            started.enter_context(ServiceProcess(name, address, folder, name=KEYS.robot))
            for name in ("planner", "executor", "servo")
        ]
        for service in services:
            service.wait_ready(bus, KEYS)
        yield address


# Generation B is what all other tests of this folder speak; the others say the same in their own messages.
@pytest.fixture(scope="module", params=[pytest.param(name, marks=pytest.mark.slow) for name in "cab"])
def arm(request: pytest.FixtureRequest, endpoint: str, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Typed]:
    with Bus(endpoint) as bus, typed(request.param, endpoint, bus, tmp_path_factory.mktemp("typed")) as started:
        yield started


def only(arm: Typed, *generations: str) -> None:
    if arm.generation not in generations:
        pytest.skip(f"generation {arm.generation.upper()} does not have it")


def goal_sets(*sets: list[dict[str, Any]]) -> dict[str, Any]:
    return {"goalsets": [{"poses": poses} for poses in sets]}


def to(arm: Typed, there: dict[str, Any]) -> dict[str, Any]:
    """The fields of a request to go to a pose."""
    return goal_sets([there]) if arm.generation == "c" else {"target_pose": there}


def go(arm: Typed, **goal: Any) -> Any:
    """Execute, in the way of the generation: A executes what is planned before."""
    if arm.generation == "a" and goal:
        planned = arm.call("generate_trajectory", "TrajectoryGeneration", **goal)
        assert planned["success"], planned["message"]
        goal = {}
    return arm.send("execute_trajectory", "SendTrajectory", **goal)


def test_the_bridge_logs_the_generation_it_finds(arm: Typed) -> None:
    said = f"curobo_msgs of generation {arm.generation.upper()}"
    assert arm.health.note == said
    assert said.replace(" ", "_") in arm.bridge.output()
    assert "not served" not in arm.bridge.output()


def test_scene_and_settings_answer(arm: Typed) -> None:
    table = {"type": 0, "name": "table", "pose": pose(0.6, 0.0, -0.2), "dimensions": {"x": 0.4, "y": 0.4, "z": 0.2}}
    assert arm.call("add_object", "AddObject", **table)["message"].startswith("Object 'table' added")
    assert arm.call("add_object", "AddObject", **table | {"name": "ball", "type": 1})["success"]
    assert arm.call("get_obstacles", TRIGGER)["message"] == "table\nball"
    assert arm.call("remove_object", "RemoveObject", name="ball")["success"]
    box = {"bbox_min_x": 0.4, "bbox_min_y": -0.2, "bbox_min_z": -0.3} | {"bbox_max_x": 0.8, "bbox_max_y": 0.2}
    grid = arm.call("get_voxel_grid", "GetVoxelGrid", **(box if arm.generation == "c" else {}))["voxel_grid"]
    assert len(grid["data"]) == grid["size_x"] * grid["size_y"] * grid["size_z"]
    assert set(grid["data"]) == ({0, 1} if arm.generation == "c" else {1})
    distances = arm.call("get_collision_distance", "GetCollisionDistance")
    assert len(distances["data"]) == distances["nb_sphere"] == SPHERES
    assert min(distances["data"]) > 0.0
    assert arm.call("remove_all_objects", TRIGGER)["message"] == "All 1 obstacles removed"
    assert arm.call("set_collision_cache", "SetCollisionCache", obb=7, mesh=-1, blox=-1)["obb_cache"] == 7
    ignored = arm.call("set_link_collision", "SetLinkCollision", link_names=["link_6", "no_link"], enabled=True)
    assert (ignored["applied_links"], ignored["unknown_links"]) == (["link_6"], ["no_link"])
    assert arm.call("get_planners", "GetPlanners")["planner_names"][0] == "classic"
    assert arm.call("set_planner", "SetPlanner", planner_type=3)["current_planner"] == "constrained"
    retarget = arm.call("set_planner", "SetPlanner", planner_type=6)
    assert retarget["current_planner"] == ("constrained" if arm.generation == "a" else "retarget")
    assert arm.call("set_planner", "SetPlanner", planner_type=0)["previous_planner"] == retarget["current_planner"]
    assert eventually(lambda: arm.parameter("node_is_available"), "it is available")


def test_kinematics_answer(arm: Typed) -> None:
    found = arm.call("ik", "Ik", pose=NEAR)
    assert (found["success"], found["joint_states_valid"], found["error_msg"]) == (True, {"data": True}, {"data": ""})
    several = arm.call("ik_batch", "IkBatch", poses=[NEAR, NOWHERE])
    assert [one["data"] for one in several["joint_states_valid"]] == [True, False]
    assert (several["success"], "1 of 2 poses" in several["error_msg"]["data"]) == (False, True)
    there = arm.call("fk", "Fk", joint_states=[found["joint_states"]])
    assert there["poses"][0]["position"] == pytest.approx(NEAR["position"], abs=1e-4)
    assert arm.call("warmup_ik", "WarmupIK", batch_size=2)["success"]
    assert arm.call("warmup_fk", "WarmupFK", batch_size=2)["success"]


def test_a_plan_has_the_points_and_their_distance_in_time(arm: Typed) -> None:
    planned = arm.call("generate_trajectory", "TrajectoryGeneration", **to(arm, NEAR))
    assert planned["success"], planned["message"]
    assert planned["dt"] == ROBOT.descriptor.interpolation_dt
    assert len(planned["trajectory"][0]["position"]) == 6
    joints = arm.call("generate_trajectory", "TrajectoryGeneration", target_joint_positions=[0.3, *HOME[1:]])
    assert joints["trajectory"][-1]["position"] == pytest.approx([0.3, *HOME[1:]])
    failed = arm.call("generate_trajectory", "TrajectoryGeneration", **to(arm, NOWHERE))
    assert (failed["success"], failed["trajectory"]) == (False, [])
    if arm.generation == "c":
        chosen = [answer["selected_goal_index"] for answer in (planned, joints, failed)]
        assert chosen == [[0], [], [-1]]


def test_feedback_has_the_form_of_the_generation(arm: Typed) -> None:
    there = FAR if arm.generation == "b" else NEAR
    ended = go(arm, **to(arm, there))
    assert ended["status"] == GoalStatus.STATUS_SUCCEEDED, ended["result"]["message"]
    assert ended["result"] == {"success": True, "message": "Trajectory executed successfully"}
    report = ended["feedback"]
    assert report[-1]["step_progression"] == 1.0
    assert len(report[-1]["joint_command"]["position"]) == 6
    if arm.generation == "a":
        assert list(report[-1]) == ["joint_command", "step_progression"]
    else:
        assert list(dict.fromkeys(one["state"] for one in report)) == ["PLANNING", "EXECUTING"]
        errors = ("position_error", "orientation_error", "controller_position_error", "controller_orientation_error")
        assert {report[-1][error] for error in errors} == {0.0}
        assert (report[-1]["on_target"], report[-1]["hold_count"]) == (False, 0)
    followed = arm.send("mpc_move", "MpcMove", target_pose=there)
    assert (followed["status"], followed["result"]["success"]) == (GoalStatus.STATUS_SUCCEEDED, True)
    assert followed["feedback"][-1]["step_progression"] == 1.0


def test_a_goal_reuses_the_plan_to_the_same_goal_where_it_may(arm: Typed) -> None:
    only(arm, "b", "c")
    for cached in (True, False):
        there = {"target_joint_positions": [0.1 if cached else -0.1, *HOME[1:]]}
        assert arm.call("generate_trajectory", "TrajectoryGeneration", **there)["success"]
        ended = go(arm, **there, allow_cached=cached)
        assert ended["status"] == GoalStatus.STATUS_SUCCEEDED, ended["result"]["message"]
        assert ("PLANNING" in {report["state"] for report in ended["feedback"]}) is not cached
    elsewhere = {"name": list(ROBOT.descriptor.joints), "position": [1.0, *HOME[1:]]}
    away = go(arm, target_joint_positions=HOME, start_pose=elsewhere)
    assert (away["status"], away["feedback"][-1]["state"]) == (GoalStatus.STATUS_ABORTED, "PLANNING")
    assert "start" in away["result"]["message"]


def test_of_several_poses_the_quickest_is_reached(arm: Typed) -> None:
    poses = [NOWHERE, FAR, NEAR]
    assert arm.call("set_planner", "SetPlanner", planner_type=2)["success"]
    start = {"position": HOME}
    if arm.generation == "c":
        planned = arm.call(
            "generate_trajectory", "TrajectoryGeneration", start_pose=start, **goal_sets([poses[0]], poses[1:])
        )
        assert planned["selected_goal_index"] == [-1, 1]
    else:
        planned = arm.call("generate_trajectory", "TrajectoryGeneration", start_pose=start, target_poses=poses)
        assert "target_poses[2]" in planned["message"]
    assert arm.call("set_planner", "SetPlanner", planner_type=4 if arm.generation != "c" else 0)["success"]
    if arm.generation == "c":
        chosen = arm.call(
            "generate_trajectory",
            "TrajectoryGeneration",
            start_pose=start,
            **goal_sets([NOWHERE, NEAR], [FAR, NOWHERE]),
        )
        assert chosen["success"], chosen["message"]
        assert chosen["selected_goal_index"] == [1, 0]
    else:
        through = arm.call("generate_trajectory", "TrajectoryGeneration", start_pose=start, target_poses=[NEAR, FAR])
        assert through["success"], through["message"]
    assert arm.call("set_planner", "SetPlanner", planner_type=0)["success"]


def test_strategies_have_the_words_of_the_generation(arm: Typed) -> None:
    sentence = "Active strategy: 'emulator'" if arm.generation == "a" else "emulator"
    assert arm.call("get_robot_strategy", TRIGGER)["message"] == sentence
    assert arm.call("get_robot_strategies", "GetRobotStrategies")["current_strategy_name"] == "emulator"
    emulator, other = (1, 2) if arm.generation == "a" else ("emulator", "ur10")
    switched = arm.call("set_robot_strategy", "SetRobotStrategy", robot_strategy=emulator)
    assert (switched["success"], switched["current_robot_strategy"]) == (True, "emulator")
    refused = arm.call("set_robot_strategy", "SetRobotStrategy", robot_strategy=other)
    assert (refused["success"], refused["current_robot_strategy"]) == (False, "emulator")


def test_generation_c_attaches_clears_and_shows(arm: Typed) -> None:
    only(arm, "c")
    attach = "isaac_ros_cumotion_interfaces/srv/AttachObject"
    ball = {"type": 1, "name": "ball", "pose": pose(0.7, 0.4, 0.7), "dimensions": {"x": 0.02, "y": 0.0, "z": 0.0}}
    assert arm.call("add_object", "AddObject", **ball)["success"]
    assert "(object_name)" in arm.call("attach_object", attach, object_name="no_ball")["message"]
    assert arm.call("attach_object", attach, object_name="ball")["success"]
    assert arm.call("detach_object", TRIGGER)["message"] == "Object 'ball' detached"
    assert not arm.call("detach_object", TRIGGER)["success"]
    assert arm.call("remove_all_objects", TRIGGER)["success"]
    assert arm.call("generate_trajectory", "TrajectoryGeneration", target_joint_positions=HOME)["success"]
    assert arm.call("clear_trajectory", TRIGGER)["success"]
    assert "cleared" in arm.send("execute_trajectory", "SendTrajectory")["result"]["message"]
    assert arm.call("clear_voxel_map", TRIGGER)["success"]
    assert arm.call("set_collision_spheres_enabled", "std_srvs/srv/SetBool", data=True)["success"]


class _Fields:
    """A message class of another package."""

    def __init__(self, fields: dict[str, str]) -> None:
        self._fields = fields

    def get_fields_and_field_types(self) -> dict[str, str]:
        return self._fields


def package(**changes: dict[str, str]) -> dict[str, Any]:
    """Classes as generation B has them, but for the parts that are changed: `SendTrajectory__Goal`."""
    classes = {}
    for name, parts in definitions("b").items():
        kind = name.split("/")[1]
        fields = {part: _Fields(changes.get(f"{kind}__{part}", dict(known))) for part, known in parts.items()}
        classes[name] = fields[""] if "" in fields else type(kind, (), fields)
    return classes


def test_what_differs_is_named_and_not_served_and_the_rest_is(monkeypatch: pytest.MonkeyPatch) -> None:
    classes = package(
        SendTrajectory__Goal={"target_pose": "geometry_msgs/Pose"},
        Fk__Response={"poses": "sequence<geometry_msgs/Pose>"},
    )
    del classes["srv/Ik"]
    monkeypatch.setattr(installed, "_class", classes.get)
    found = installed.installed()
    assert (found.letter, str(found)) == ("b", "curobo_msgs of generation B, but for 3 types")
    assert sorted(found.differences) == [
        "action/SendTrajectory.Goal has geometry_msgs/Pose target_pose where sensor_msgs/JointState start_pose belongs",
        "srv/Fk.Response has no joint_states_valid",
        "srv/Ik is not in the curobo_msgs that is installed",
    ]
    assert not {"action/SendTrajectory", "srv/Fk", "srv/Ik"} & set(found.types)
    assert {"srv/TrajectoryGeneration", "action/MpcMove"} <= set(found.types)


def test_an_earlier_generation_b_is_one(monkeypatch: pytest.MonkeyPatch) -> None:
    later = dict(definitions("b")["action/SendTrajectory"]["Feedback"])
    earlier = {name: kind for name, kind in later.items() if not name.startswith("controller_")}
    monkeypatch.setattr(installed, "_class", package(SendTrajectory__Feedback=earlier).get)
    found = installed.installed()
    assert (found.letter, found.differences) == ("b", ())
