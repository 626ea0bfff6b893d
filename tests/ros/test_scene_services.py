"""The scene by services of ROS: against a planner, an executor and a bridge that run, with plain types."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any

import pytest
import trimesh
from geometry_msgs.msg import Point, Pose, Quaternion, Vector3
from rcl_interfaces.msg import Parameter, ParameterValue
from rcl_interfaces.srv import GetParameters, SetParameters
from std_srvs.srv import Trigger

from curobo_msgs.srv import (
    AddObject,
    GetCollisionDistance,
    RemoveObject,
    SetCollisionCache,
    SetLinkCollision,
    TrajectoryGeneration,
)
from support.ros.stack import KEYS, Stack, stack
from zarm.connection import Connection
from zarm.robot import Robot
from zarm_contract.messages import Cuboid, Scene, Sphere
from zarm_contract.robot import load_robot

ROBOT = load_robot("doosan_m1013")
HOME = ROBOT.descriptor.home
SPHERES = [link for link, balls in ROBOT.descriptor.spheres.items() for _ in balls]
Request = AddObject.Request


@pytest.fixture(scope="module")
def running(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Stack]:
    meshes = tmp_path_factory.mktemp("meshes")
    trimesh.creation.box((100.0, 100.0, 100.0)).export(meshes / "box.stl")
    with stack(tmp_path_factory.mktemp("stack"), planner=("--meshes", str(meshes))) as processes:
        yield processes


@pytest.fixture
def arm(running: Stack) -> Stack:
    """The same with an empty scene."""
    assert running.ros.call(Trigger, "remove_all_objects").success
    return running


def at(x: float, y: float, z: float) -> Pose:
    return Pose(position=Point(x=x, y=y, z=z))


def add(arm: Stack, kind: int, name: str, pose: Pose, *size: float, **more: Any) -> Any:
    x, y, z = (*size, 0.0, 0.0)[:3]
    dimensions = Vector3(x=x, y=y, z=z)
    return arm.ros.call(AddObject, "add_object", type=kind, name=name, pose=pose, dimensions=dimensions, **more)


def scene(arm: Stack) -> Scene:
    return arm.bus.read(KEYS.scene, timeout=10)


def test_every_kind_of_object_becomes_an_obstacle_of_its_size(arm: Stack) -> None:
    assert add(arm, Request.CUBOID, "box", at(0.6, 0.0, 0.1), 0.1, 0.2, 0.3).success
    assert add(arm, Request.SPHERE, "ball", at(0.6, 0.4, 0.1), 0.05).success
    assert add(arm, Request.CAPSULE, "pill", at(0.6, -0.4, 0.1), 0.05, 0.0, 0.2).success
    assert add(arm, Request.CYLINDER, "can", at(0.6, -0.6, 0.1), 0.05, 0.0, 0.2).success
    assert add(arm, Request.MESH, "part", at(0.6, 0.6, 0.1), 1e-3, 1e-3, 1e-3, mesh_file_path="box.stl").success
    listed = arm.ros.call(Trigger, "get_obstacles")
    assert (listed.success, listed.message) == (True, "box\nball\npill\ncan\npart")
    box, ball, *_ = scene(arm).objects
    assert box == Cuboid(kind="cuboid", name="box", position=(0.6, 0.0, 0.1), size=(0.1, 0.2, 0.3))
    assert ball == Sphere(kind="sphere", name="ball", position=(0.6, 0.4, 0.1), radius=0.05)


def test_an_orientation_left_at_zeros_is_none(arm: Stack) -> None:
    pose = Pose(position=Point(x=0.6), orientation=Quaternion(x=0.0, y=0.0, z=0.0, w=0.0))
    assert add(arm, Request.CUBOID, "box", pose, 0.1, 0.1, 0.1).success
    assert scene(arm).objects[0].orientation == (0.0, 0.0, 0.0, 1.0)


def test_an_object_goes_by_its_name_and_all_go_at_once(arm: Stack) -> None:
    add(arm, Request.SPHERE, "one", at(0.6, 0.0, 0.1), 0.05)
    add(arm, Request.SPHERE, "two", at(0.6, 0.3, 0.1), 0.05)
    assert arm.ros.call(RemoveObject, "remove_object", name="one").success
    assert arm.ros.call(Trigger, "get_obstacles").message == "two"
    unknown = arm.ros.call(RemoveObject, "remove_object", name="one")
    assert not unknown.success
    assert "one" in unknown.message
    assert unknown.message.endswith("(name)")
    assert arm.ros.call(Trigger, "remove_all_objects").success
    assert arm.ros.call(Trigger, "get_obstacles").message == ""


REFUSED: dict[str, tuple[dict[str, Any], str]] = {
    "no kind": ({"type": 9}, "type"),
    "no name": ({"name": ""}, "name"),
    "a name that stands already": ({"name": "there"}, "name"),
    "no size": ({"dimensions": Vector3()}, "dimensions.x"),
    "a size that is no number": ({"dimensions": Vector3(x=0.1, y=math.nan, z=0.1)}, "dimensions.y"),
    "a size that nothing has": ({"dimensions": Vector3(x=0.1, y=0.1, z=1e6)}, "dimensions.z"),
    "the moon": ({"pose": at(4e8, 0.0, 0.0)}, "pose.position"),
    "a turn that is none": ({"pose": Pose(orientation=Quaternion(x=1.0, w=1.0))}, "pose.orientation"),
    "no mesh": ({"type": Request.MESH, "mesh_file_path": "nothing.stl"}, "mesh_file_path"),
    "a mesh elsewhere": ({"type": Request.MESH, "mesh_file_path": "/etc/passwd.stl"}, "mesh_file_path"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_an_invalid_object_is_refused_by_field(arm: Stack, case: str) -> None:
    add(arm, Request.SPHERE, "there", at(0.6, 0.3, 0.1), 0.05)
    before = scene(arm)
    wrong, field = REFUSED[case]
    good = {
        "type": Request.CUBOID,
        "name": "box",
        "pose": at(0.6, 0.0, 0.1),
        "dimensions": Vector3(x=0.1, y=0.1, z=0.1),
    }
    response = arm.ros.call(AddObject, "add_object", **(good | wrong))
    assert not response.success
    assert response.message.endswith(f"({field})"), response.message
    assert scene(arm) == before


def test_plans_go_around_what_was_added(arm: Stack) -> None:
    behind = [1.6, *HOME[1:]]
    straight = arm.ros.call(TrajectoryGeneration, "generate_trajectory", target_joint_positions=behind)
    assert add(arm, Request.CYLINDER, "post", at(0.38, 0.38, 0.4), 0.04, 0.0, 0.9).success
    around = arm.ros.call(TrajectoryGeneration, "generate_trajectory", target_joint_positions=behind)
    assert straight.success
    assert around.success
    assert any(in_collision(arm, positions(straight)))
    assert not any(in_collision(arm, positions(around)))


def positions(planned: Any) -> list[list[float]]:
    return [list(state.position) for state in planned.trajectory[::4]]


def in_collision(arm: Stack, points: Sequence[Sequence[float]]) -> list[bool]:
    """Whether the robot collides, at each of these joints."""
    return [result.in_collision for result in Robot(Connection.of(arm.bus, KEYS)).check(points)]


def distances(arm: Stack) -> list[float]:
    response = arm.ros.call(GetCollisionDistance, "get_collision_distance")
    assert len(response.data) == response.nb_sphere
    return list(response.data)


def test_distances_are_given_per_sphere_negative_inside(arm: Stack) -> None:
    assert len(distances(arm)) == len(SPHERES)
    assert min(distances(arm)) > 0.0
    add(arm, Request.SPHERE, "ball", at(0.45, 0.0, 0.7), 0.3)
    assert min(distances(arm)) < -0.01


def test_the_cache_keeps_the_numbers_it_is_told(arm: Stack) -> None:
    first = arm.ros.call(SetCollisionCache, "set_collision_cache", obb=7, mesh=-1, blox=-1)
    assert first.success
    second = arm.ros.call(SetCollisionCache, "set_collision_cache", obb=-1, mesh=3, blox=-1)
    assert (second.success, second.obb_cache, second.mesh_cache) == (True, 7, 3)
    assert second.blox_cache == first.blox_cache
    refused = arm.ros.call(SetCollisionCache, "set_collision_cache", obb=1, mesh=-2, blox=-1)
    assert (refused.success, refused.obb_cache, refused.mesh_cache) == (False, 7, 3)
    assert refused.message.endswith("(mesh)")
    values = arm.ros.call(GetParameters, "get_parameters", names=["obb_cache_size", "mesh_cache_size"]).values
    assert [value.integer_value for value in values] == [7, 3]


def test_links_are_looked_at_or_not_and_unknown_ones_are_named(arm: Stack) -> None:
    add(arm, Request.SPHERE, "ball", at(0.45, 0.0, 0.7), 0.3)
    links = ["link_3", "link_4", "link5", "link6", "link_2", "link_1"]  # in both spellings of the lab
    try:
        off = arm.ros.call(SetLinkCollision, "set_link_collision", link_names=links, enabled=False)
        assert (off.success, list(off.applied_links), list(off.unknown_links)) == (True, links, [])
        assert not in_collision(arm, [HOME])[0]
        some = arm.ros.call(SetLinkCollision, "set_link_collision", link_names=["hand", "link_4"], enabled=True)
        assert (some.success, list(some.applied_links), list(some.unknown_links)) == (False, ["link_4"], ["hand"])
        assert "hand" in some.message
    finally:
        on = arm.ros.call(SetLinkCollision, "set_link_collision", link_names=links, enabled=True)
        assert on.success
    assert in_collision(arm, [HOME])[0]
    none = arm.ros.call(SetLinkCollision, "set_link_collision", link_names=[], enabled=True)
    assert not none.success
    every = arm.ros.call(SetLinkCollision, "set_link_collision", link_names=["base_link", *links], enabled=False)
    assert (every.success, list(every.applied_links)) == (False, [])


def set_parameter(arm: Stack, name: str, value: ParameterValue) -> Any:
    changed = [Parameter(name=name, value=value)]
    return arm.ros.call(SetParameters, "set_parameters", parameters=changed).results[0]
