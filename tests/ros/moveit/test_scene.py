"""One scene: what clients of MoveIt add, move, attach and save is zarm's, and the other way round."""

from __future__ import annotations

import struct
from array import array
from base64 import b64encode
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from geometry_msgs.msg import Point, Pose
from moveit_msgs.msg import (
    AllowedCollisionEntry,
    AllowedCollisionMatrix,
    AttachedCollisionObject,
    CollisionObject,
    LinkPadding,
    ObjectColor,
    PlanningScene,
    PlanningSceneComponents,
    PlanningSceneWorld,
    RobotState,
)
from moveit_msgs.srv import (
    ApplyPlanningScene,
    GetPlanningScene,
    GetStateValidity,
    LoadGeometryFromFile,
    SaveGeometryToFile,
)
from octomap_msgs.msg import OctomapWithPose
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState
from shape_msgs.msg import Plane, SolidPrimitive
from std_msgs.msg import ColorRGBA
from std_srvs.srv import Empty

import zarm
from support.harness import eventually
from support.ros.moveit import quaternion
from support.ros.stack import KEYS, Stack
from zarm.connection import Connection
from zarm.robot import Robot
from zarm_contract.messages import VoxelBlock, Voxels
from zarm_contract.robot import load_robot
from zarm_geometry.frames import matrix
from zarm_ros_bridge.moveit.octomap import octomap

ROBOT = load_robot("doosan_m1013")
JOINTS, HOME = ROBOT.descriptor.joints, ROBOT.descriptor.home


@pytest.fixture
def robot(arm: Stack) -> Iterator[Robot]:
    """The robot at home, in an empty scene, which is empty again afterwards."""
    robot = Robot(Connection.of(arm.bus, KEYS))
    robot.scene.clear()
    robot.execute(robot.plan(HOME))
    yield robot
    robot.scene.clear()


def at(x: float, y: float, z: float, q: tuple[float, ...] = (0.0, 0.0, 0.0, 1.0)) -> Pose:
    return Pose(position=Point(x=x, y=y, z=z), orientation=quaternion(q))


def shape(kind: int, *sizes: float) -> SolidPrimitive:
    return SolidPrimitive(type=kind, dimensions=list(sizes))


def item(identity: str, where: Pose, *shapes: tuple[SolidPrimitive, Pose], **fields: object) -> CollisionObject:
    made = CollisionObject(id=identity, pose=where, **fields)
    made.header.frame_id = "base_link"
    made.primitives = [solid for solid, _ in shapes]
    made.primitive_poses = [pose for _, pose in shapes]
    return made


SHELF = item(
    "shelf",
    at(0.9, 0.0, 0.2, (0.0, 0.0, 0.6, 0.8)),
    (shape(SolidPrimitive.BOX, 0.4, 0.02, 0.4), at(0.0, 0.1, 0.0)),
    (shape(SolidPrimitive.CYLINDER, 0.5, 0.03), at(0.0, -0.1, 0.0)),
)


def applied(arm: Stack, **fields: object) -> bool:
    scene = PlanningScene(is_diff=True)
    scene.world.collision_objects = fields.pop("objects", [])
    for name, value in fields.items():
        setattr(scene, name, value)
    return bool(arm.ros.call(ApplyPlanningScene, "/apply_planning_scene", scene=scene).success)


def fetched(arm: Stack) -> PlanningScene:
    return arm.ros.call(GetPlanningScene, "/get_planning_scene", components=PlanningSceneComponents()).scene


def test_an_object_of_several_shapes_is_moved_as_one(arm: Stack, robot: Robot) -> None:
    assert applied(arm, objects=[SHELF])
    parts = robot.scene.objects()
    assert set(parts) == {"shelf..0", "shelf..1"}
    (found,) = fetched(arm).world.collision_objects
    assert (found.id, len(found.primitives)) == ("shelf", 2)
    assert found.pose.position.x == pytest.approx(0.9)
    assert found.primitive_poses[0].position.y == pytest.approx(0.1)
    apart = np.subtract(parts["shelf..0"].position, parts["shelf..1"].position)
    assert applied(
        arm, objects=[item("shelf", at(0.9, 0.4, 0.2, (0.0, 0.0, 0.6, 0.8)), operation=CollisionObject.MOVE)]
    )
    moved = robot.scene.objects()
    assert np.allclose(np.subtract(moved["shelf..0"].position, parts["shelf..0"].position), (0.0, 0.4, 0.0))
    assert np.allclose(np.subtract(moved["shelf..0"].position, moved["shelf..1"].position), apart)
    more = item("shelf", at(0.9, 0.4, 0.5), (shape(SolidPrimitive.SPHERE, 0.05), at(0.0, 0.0, 0.0)))
    more.operation = CollisionObject.APPEND
    assert applied(arm, objects=[more])
    assert set(robot.scene.objects()) == {"shelf..0", "shelf..1", "shelf..2"}
    assert applied(arm, objects=[item("shelf", at(0.0, 0.0, 0.0), operation=CollisionObject.REMOVE)])
    assert not robot.scene.objects()


def test_the_weight_of_what_is_attached_is_its_mass(arm: Stack, robot: Robot) -> None:
    assert applied(arm, objects=[SHELF])
    held = AttachedCollisionObject(link_name="link_6", object=CollisionObject(id="shelf"), weight=3.0)
    assert applied(arm, robot_state=RobotState(is_diff=True, attached_collision_objects=[held]))
    assert [part.mass for part in robot.scene.attached().values()] == [1.5, 1.5]
    (carried,) = fetched(arm).robot_state.attached_collision_objects
    assert (carried.object.id, carried.weight) == ("shelf", 3.0)
    robot.scene.detach("shelf..0")
    robot.scene.detach("shelf..1")


def test_edits_that_come_quickly_are_applied_in_their_order(arm: Stack, robot: Robot) -> None:
    publisher = arm.ros.node.create_publisher(CollisionObject, "/collision_object", 100)
    eventually(publisher.get_subscription_count, "the bridge listens")
    box = shape(SolidPrimitive.BOX, 0.1, 0.1, 0.1)
    for i in range(10):
        publisher.publish(item(f"box{i}", at(0.9, 0.1 * i, 0.3), (box, at(0.0, 0.0, 0.0))))
    for step in range(20):
        publisher.publish(item("box3", at(0.9, 0.3, 0.3 + 0.01 * step), operation=CollisionObject.MOVE))
    publisher.publish(item("box9", at(0.0, 0.0, 0.0), operation=CollisionObject.REMOVE))

    def last() -> bool:
        found = robot.scene.objects()
        others = {f"box{i}" for i in range(9)}
        return set(found) == others and found["box3"].position == pytest.approx((0.9, 0.3, 0.49))

    eventually(last, "the last edits are applied")
    arm.ros.node.destroy_publisher(publisher)


def test_zarm_s_objects_are_in_the_planning_scene(arm: Stack, robot: Robot) -> None:
    heard = arm.ros.heard(PlanningScene, "/monitored_planning_scene", QoSProfile(depth=10))
    robot.scene.add(zarm.Capsule("pipe", radius=0.05, length=0.4, position=(0.8, 0.5, 0.3)))
    robot.scene.add(zarm.Cuboid("table", size=(0.5, 0.5, 0.02), position=(0.9, -0.5, 0.1)))
    eventually(
        lambda: heard and {one.id for one in heard[-1].world.collision_objects} == {"pipe", "table"},
        "both are published",
    )
    assert not heard[-1].is_diff
    found = {one.id: one for one in fetched(arm).world.collision_objects}
    assert [one.type for one in found["pipe"].primitives] == [
        SolidPrimitive.CYLINDER,
        SolidPrimitive.SPHERE,
        SolidPrimitive.SPHERE,
    ]
    assert list(found["table"].primitives[0].dimensions) == pytest.approx([0.5, 0.5, 0.02])


def test_a_plane_is_a_floor_and_colours_stay(arm: Stack, robot: Robot) -> None:
    floor = item("floor", at(0.0, 0.0, 0.0))
    floor.planes, floor.plane_poses = [Plane(coef=[0.0, 0.0, 2.0, 0.4])], [at(0.0, 0.0, 0.0)]
    assert applied(arm, objects=[floor])
    slab = robot.scene.objects()["floor"]
    assert slab.position[2] + slab.size[2] / 2 == pytest.approx(-0.2)
    colour = ColorRGBA(r=0.1, g=0.2, b=0.3, a=1.0)
    assert applied(arm, object_colors=[ObjectColor(id="floor", color=colour)])
    (shown,) = fetched(arm).object_colors
    assert (shown.id, round(shown.color.b, 3)) == ("floor", 0.3)


def test_what_is_refused_changes_nothing(arm: Stack, robot: Robot) -> None:
    assert not applied(arm, link_padding=[LinkPadding(link_name="link_5", padding=0.02)])
    assert not applied(arm, objects=[item("thing", at(0.5, 0.0, 0.5), (shape(SolidPrimitive.BOX, 0.1), at(0, 0, 0)))])
    assert not applied(arm, objects=[item("nothing", at(0.5, 0.0, 0.5))])
    lost = item("lost", at(0.5, 0.0, 0.5), (shape(SolidPrimitive.SPHERE, 0.1), at(0.0, 0.0, 0.0)))
    lost.header.frame_id = "moon"
    assert not applied(arm, objects=[lost])
    assert not applied(arm, objects=[item("gone", at(0.0, 0.0, 0.0), operation=CollisionObject.REMOVE)])
    assert not robot.scene.objects()


POST = item("post", at(0.9, 0.0, 0.2), (shape(SolidPrimitive.BOX, 0.1, 0.1, 0.4), at(0.0, 0.0, 0.0)))


def allowing(*pairs: tuple[str, str]) -> AllowedCollisionMatrix:
    """The matrix of a client, of the names in it alone."""
    names = sorted({name for pair in pairs for name in pair} | {"link_6"})
    rows = [[(a, b) in pairs or (b, a) in pairs for b in names] for a in names]
    return AllowedCollisionMatrix(entry_names=names, entry_values=[AllowedCollisionEntry(enabled=row) for row in rows])


def test_a_pair_of_the_collision_matrix_is_the_scenes_both_ways(arm: Stack, robot: Robot) -> None:
    assert applied(
        arm, objects=[POST, SHELF], allowed_collision_matrix=allowing(("link_6", "post"), ("link_5", "shelf"))
    )
    assert robot.scene.read().ignored_pairs == (("link_5", "shelf..0"), ("link_5", "shelf..1"), ("link_6", "post"))
    found = fetched(arm).allowed_collision_matrix
    row = dict(zip(found.entry_names, found.entry_values[found.entry_names.index("post")].enabled, strict=True))
    assert [name for name, allowed in row.items() if allowed] == ["link_6"]
    assert applied(arm, allowed_collision_matrix=found)
    assert len(robot.scene.read().ignored_pairs) == 3
    robot.scene.set_pair_collision(("link_6", "post"), enabled=True)
    found = fetched(arm).allowed_collision_matrix
    assert "post" not in found.entry_names
    assert applied(arm, allowed_collision_matrix=allowing(("link_6", "post")))
    assert robot.scene.read().ignored_pairs == (("link_6", "post"),)
    assert not applied(arm, allowed_collision_matrix=allowing(("link_6", "nobody")))
    robot.scene.clear()
    assert robot.scene.read().ignored_pairs == ()


def test_the_octomap_may_be_touched_by_single_links(arm: Stack, robot: Robot) -> None:
    assert applied(arm, allowed_collision_matrix=allowing(("<octomap>", "link_6")))
    assert robot.scene.read().ignored_pairs == (("link_6", "map"),)
    found = fetched(arm).allowed_collision_matrix
    row = dict(zip(found.entry_names, found.entry_values[found.entry_names.index("<octomap>")].enabled, strict=True))
    assert [name for name, allowed in row.items() if allowed] == ["link_6"]
    whole = AllowedCollisionMatrix(default_entry_names=["<octomap>"], default_entry_values=[True])
    assert not applied(arm, allowed_collision_matrix=whole)
    assert applied(arm, allowed_collision_matrix=allowing(("link_5", "link_6")))
    assert robot.scene.read().ignored_pairs == ()


def test_a_message_with_a_fault_changes_nothing_at_all(arm: Stack, robot: Robot) -> None:
    assert applied(arm, objects=[SHELF])
    before = robot.scene.read(), robot.settings().margin
    padding = [LinkPadding(link_name=link, padding=0.02) for link in ROBOT.descriptor.collision]
    assert not applied(arm, objects=[POST, item("", at(0.9, 0.5, 0.2))], link_padding=padding)
    assert not applied(arm, objects=[POST, item("gone", at(0.9, 0.5, 0.2), operation=CollisionObject.REMOVE)])
    far = item("far", at(1e6, 0.0, 0.0), (shape(SolidPrimitive.BOX, 0.1, 0.1, 0.4), at(0.0, 0.0, 0.0)))
    assert not applied(arm, objects=[POST, far], link_padding=padding)
    gone = item("shelf", at(0.0, 0.0, 0.0), operation=CollisionObject.REMOVE)
    assert not applied(arm, objects=[gone, far], link_padding=padding)
    assert (robot.scene.read(), robot.settings().margin) == before


def test_the_scene_is_saved_and_loaded(arm: Stack, robot: Robot, tmp_path: Path) -> None:
    cone = item("cone", at(-0.8, 0.5, 0.3), (shape(SolidPrimitive.CONE, 0.3, 0.1), at(0.0, 0.0, 0.0)))
    assert applied(arm, objects=[SHELF, cone])
    before = robot.scene.objects()
    file = str(tmp_path / "cell.scene")
    assert arm.ros.call(SaveGeometryToFile, "/save_geometry_to_file", file_path_and_name=file).success
    robot.scene.clear()
    assert arm.ros.call(LoadGeometryFromFile, "/load_geometry_from_file", file_path_and_name=file).success
    after = robot.scene.objects()
    assert set(after) == set(before)
    assert after["shelf..0"].size == pytest.approx(before["shelf..0"].size)
    assert after["shelf..1"].position == pytest.approx(before["shelf..1"].position)
    assert (after["shelf..1"].radius, after["shelf..1"].length) == pytest.approx((0.03, 0.5))
    for wrong in ("cell.txt", "none.scene"):
        answer = arm.ros.call(
            LoadGeometryFromFile, "/load_geometry_from_file", file_path_and_name=str(tmp_path / wrong)
        )
        assert not answer.success


def test_a_text_of_an_earlier_moveit_is_loaded(arm: Stack, robot: Robot, tmp_path: Path) -> None:
    file = tmp_path / "old.scene"
    file.write_text("cell\n* block\n1\nbox\n0.1 0.2 0.3\n0.9 0.1 0.2\n0 0 0 1\n0 0 0 0\n.\n")
    assert arm.ros.call(LoadGeometryFromFile, "/load_geometry_from_file", file_path_and_name=str(file)).success
    assert robot.scene.objects()["block"].position == pytest.approx((0.9, 0.1, 0.2))


def test_a_state_is_valid_or_names_what_it_touches(arm: Stack, robot: Robot) -> None:
    state = fetched(arm).robot_state
    state.joint_state = JointState(name=list(JOINTS), position=list(HOME))
    free = arm.ros.call(GetStateValidity, "/check_state_validity", robot_state=state, group_name="arm")
    assert free.valid
    x, y, z = robot.fk([HOME])[0].position
    robot.scene.add(zarm.Sphere("ball", radius=0.1, position=(x, y, z)))
    hit = arm.ros.call(GetStateValidity, "/check_state_validity", robot_state=state, group_name="arm")
    assert not hit.valid
    (contact,) = hit.contacts
    assert "ball" in (contact.contact_body_1, contact.contact_body_2)
    assert contact.depth > 0.0


def leaves(placed: OctomapWithPose) -> set[tuple[float, ...]]:
    """The centres of the occupied cells of an octomap, read as OctoMap reads it: node by node, depth first."""
    message, origin = placed.octomap, placed.origin.position
    if not message.data:
        return set()
    data = iter(np.array(message.data, np.int8).view(np.uint8).tolist())
    found, size = set(), message.resolution * 2**15

    def node(center: tuple[float, ...], half: float) -> None:
        children = [next(data), next(data)]
        inner = []
        for k in range(8):
            kind = children[k // 4] >> 2 * (k % 4) & 0b11
            at = tuple(c + (half / 2 if k >> axis & 1 else -half / 2) for axis, c in enumerate(center))
            if kind == 0b11:
                inner.append(at)
            elif kind == 0b10:
                assert half == message.resolution
                found.add(tuple(round(value, 6) for value in at))
        for at in inner:
            node(at, half / 2)

    node((origin.x, origin.y, origin.z), size)
    assert next(data, None) is None
    return found


def test_what_cameras_see_is_the_octomap_of_the_planning_scene(arm: Stack, robot: Robot) -> None:
    scenes = arm.ros.heard(PlanningScene, "/monitored_planning_scene", QoSProfile(depth=10))
    robot.scene.add(zarm.Sphere("ball", radius=0.05, position=(0.8, 0.5, 0.3)))
    eventually(lambda: scenes, "the whole scene comes first")
    blocks, rng = arm.bus.latched(KEYS.voxels("*")), np.random.default_rng(0)
    centers = set()
    for name, corner in {"0.0.0": (-0.99, -0.99, -0.24), "3.4.1": (-0.03, 0.29, 0.08)}.items():
        cells = rng.random((16, 16, 16)) < 0.1
        packed = b64encode(np.packbits(cells).tobytes()).decode()
        blocks.set(VoxelBlock(position=corner, resolution=0.02, cells=packed), key=KEYS.voxels(name))
        centers |= {tuple(row) for row in np.round(np.argwhere(cells) * 0.02 + corner, 6).tolist()}

    def shown(wanted: set[tuple[float, ...]]) -> bool:
        maps = [scene.world.octomap for scene in scenes if scene.is_diff and scene.world.octomap.header.frame_id]
        return bool(maps) and leaves(maps[-1]) == wanted

    eventually(lambda: shown(centers), "both blocks are in the octomap")
    asked = PlanningSceneComponents(components=PlanningSceneComponents.OCTOMAP)
    world = arm.ros.call(GetPlanningScene, "/get_planning_scene", components=asked).scene.world.octomap
    assert (world.octomap.id, world.octomap.binary, world.octomap.resolution) == ("OcTree", True, 0.02)
    assert leaves(world) == centers
    for name in ("0.0.0", "3.4.1"):
        blocks.set(VoxelBlock(position=(0.0, 0.0, 0.0), resolution=0.02), key=KEYS.voxels(name))
    eventually(lambda: shown(set()), "the map is empty")


def binary_map(cells: np.ndarray, resolution: float) -> OctomapWithPose:
    """An octomap with these cells (n, 3) occupied, as the bridge writes one; cell (0, 0, 0) begins at the origin."""
    voxels = Voxels(
        kind="voxels", name="map", position=(resolution / 2,) * 3, resolution=resolution, cells=tuple(map(tuple, cells.tolist()))
    )  # fmt: skip
    return octomap([voxels], "base_link")


def full_map(resolution: float) -> OctomapWithPose:
    """An octree as `octomap_msgs::fullMapToMsg` writes it: a pruned leaf of 2 x 2 x 2 occupied cells from (0, 0, 0) on, and a free leaf beside it."""
    levels = [struct.pack("<fB", 0.0, 1 << 7)]  # the root: its last child has only positive coordinates
    levels += [struct.pack("<fB", 0.0, 1)] * 13
    levels.append(struct.pack("<fB", 0.0, 0b11))
    levels.append(struct.pack("<fB", 2.2, 0) + struct.pack("<fB", -1.4, 0))
    message = OctomapWithPose()
    message.header.frame_id = "base_link"
    message.octomap.id, message.octomap.resolution = "OcTree", resolution
    message.octomap.data = array("b", b"".join(levels))
    return message


def centers_of(robot: Robot) -> np.ndarray:
    """The centres (n, 3) of the cells of the octomap in the scene."""
    (item,) = (one for one in robot.scene.read().objects if one.name == "octomap")
    assert isinstance(item, Voxels)
    pose = matrix(item.position, item.orientation)
    return np.array(item.cells) * item.resolution @ pose[:3, :3].T + pose[:3, 3]


def test_octomap_of_a_client_is_in_the_scene_and_is_shown_as_one(arm: Stack, robot: Robot) -> None:
    cells = np.argwhere(np.random.default_rng(1).random((6, 7, 8)) < 0.3) + (5, -3, 8)
    sent = binary_map(cells, 0.05)
    sent.origin.position.x = 0.1
    assert applied(arm, world=PlanningSceneWorld(octomap=sent))
    expected = np.sort((cells + 0.5) * 0.05 + (0.1, 0.0, 0.0), axis=0)
    assert np.sort(centers_of(robot), axis=0) == pytest.approx(expected, abs=1e-9)
    asked = PlanningSceneComponents(
        components=PlanningSceneComponents.OCTOMAP | PlanningSceneComponents.WORLD_OBJECT_NAMES
    )
    shown = arm.ros.call(GetPlanningScene, "/get_planning_scene", components=asked).scene.world
    assert shown.collision_objects == []
    assert np.sort(np.array([*leaves(shown.octomap)]), axis=0) == pytest.approx(expected, abs=1e-6)
    turned = binary_map(cells, 0.05)
    turned.origin = at(0.0, 0.0, 0.5, (0.0, 0.0, 1.0, 0.0))
    assert applied(arm, world=PlanningSceneWorld(octomap=turned)), "it takes the place of the one before"
    half_turn = ((cells + 0.5) * 0.05) * (-1, -1, 1) + (0.0, 0.0, 0.5)
    assert np.sort(centers_of(robot), axis=0) == pytest.approx(np.sort(half_turn, axis=0), abs=1e-9)
    assert applied(arm), "a change of something else leaves it"
    assert len(centers_of(robot)) == len(cells)
    arm.ros.call(Empty, "/clear_octomap")
    assert robot.scene.objects() == {}


def test_occupied_octomap_leaves_are_in_the_scene(arm: Stack, robot: Robot) -> None:
    assert applied(arm, world=PlanningSceneWorld(octomap=full_map(0.1)))
    assert sorted(map(tuple, np.round(centers_of(robot), 6).tolist())) == [
        (x, y, z) for x in (0.05, 0.15) for y in (0.05, 0.15) for z in (0.05, 0.15)
    ]
    empty = OctomapWithPose()
    empty.header.frame_id, empty.octomap.id = "base_link", "OcTree"
    assert applied(arm, world=PlanningSceneWorld(octomap=empty))
    assert robot.scene.objects() == {}


@pytest.mark.parametrize("change", ["id", "cut", "large", "fine"])
def test_an_invalid_octomap_is_refused_and_changes_nothing(arm: Stack, robot: Robot, change: str) -> None:
    message = full_map(0.1)
    if change == "id":
        message.octomap.id = "ColorOcTree"
    if change == "cut":
        message.octomap.data = message.octomap.data[:-3]
    if change == "large":
        message.octomap.data = array("b", struct.pack("<fB", 1.0, 0))
    if change == "fine":
        message.octomap.resolution = 1e-6
    assert not applied(arm, world=PlanningSceneWorld(octomap=message))
    assert robot.scene.objects() == {}


def test_padding_of_all_links_is_the_margin(arm: Stack, robot: Robot) -> None:
    links = ROBOT.descriptor.collision
    before = robot.settings().margin
    try:
        assert applied(arm, link_padding=[LinkPadding(link_name=link, padding=0.02) for link in links])
        assert robot.settings().margin == pytest.approx(0.02)
        assert applied(arm, link_padding=[LinkPadding(link_name=link) for link in links])
        assert robot.settings().margin == pytest.approx(0.02), "none leaves it"
        odd = [LinkPadding(link_name=link, padding=0.01 * (k == 0)) for k, link in enumerate(links)]
        assert not applied(arm, link_padding=odd)
    finally:
        robot.settings(margin=before)
