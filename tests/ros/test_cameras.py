"""Depth images of a ROS camera become voxels, whenever the camera is declared."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import pytest
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import CameraInfo, Image, LaserScan, PointCloud2, PointField

import zarm
from support.harness import ServiceProcess, eventually, router
from zarm_contract.keys import Keys
from zarm_contract.messages import Camera, JointState
from zarm_contract.robot import load_robot
from zarm_geometry.voxel_blocks import VoxelBlocks
from zarm_ros_bridge.convert.times import ros_time
from zarm_runtime.bus import Bus

M1013 = load_robot("doosan_m1013")
KEYS = Keys("doosan_m1013")
TOPIC = "/camera/depth/image_rect_raw"
DOWN = (1.0, 0.0, 0.0, 0.0)


def camera(topic: str | None = TOPIC) -> Camera:
    """1 m above a point beside the robot, looking down."""
    return Camera(
        name="front", position=(0.7, 0.7, 1.0), orientation=DOWN, topic=topic,
        width=64, height=48, fx=100.0, fy=100.0, cx=31.5, cy=23.5,
    )  # fmt: skip


class Lab:
    """A bridge and a perception, and a robot that stands."""

    def __init__(self, stack: ExitStack, folder: Path) -> None:
        endpoint = stack.enter_context(router())
        self.bus = stack.enter_context(Bus(endpoint))
        for service in ("perception", "ros_bridge"):
            stack.enter_context(ServiceProcess(service, endpoint, folder)).wait_ready(self.bus, KEYS)
        self.blocks = VoxelBlocks()
        self.bus.watch(KEYS.voxels("*"), self.blocks.receive)
        self.joints = self.bus.publisher(KEYS.joint_states)
        self.robot = stack.enter_context(zarm.connect(endpoint))

    def expect_a_plane_below_the_camera(self) -> None:
        """All voxels are 80 cm below the camera, in the middle of what it sees."""
        found = self.blocks.objects.values()
        points = np.concatenate([np.array(one.cells) * one.resolution + one.position for one in found])
        np.testing.assert_allclose(points[:, 2], 0.2, atol=0.011)
        np.testing.assert_allclose(points.mean(axis=0)[:2], 0.7, atol=0.02)

    def stand(self) -> None:
        home = M1013.descriptor.home
        state = JointState(stamp=time.time(), joint_names=M1013.descriptor.joints, position=home, velocity=(0.0,) * 6)
        self.joints.put(state)


@pytest.fixture(scope="module")
def processes(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Lab]:
    with ExitStack() as stack:
        yield Lab(stack, tmp_path_factory.mktemp("lab"))


@pytest.fixture
def lab(processes: Lab) -> Iterator[Lab]:
    """Without cameras, and with an empty map."""
    yield processes
    for one in processes.robot.perception.cameras():
        processes.robot.perception.remove(one.name)
    processes.robot.perception.clear()
    eventually(lambda: not processes.blocks.objects, "the map is empty")


def flat(depth: float, encoding: str, *, big: bool = False, padding: int = 0) -> Image:
    kind = np.dtype("f4" if encoding == "32FC1" else "u2").newbyteorder(">" if big else "<")
    value = depth if encoding == "32FC1" else 1000.0 * depth
    rows = np.full((48, 64), value, kind).view(np.uint8).reshape(48, -1)
    data = np.pad(rows, ((0, 0), (0, padding)))
    image = Image(width=64, height=48, encoding=encoding, is_bigendian=big, step=data.shape[1], data=data.tobytes())
    image.header.stamp = ros_time(time.time())
    return image


@pytest.mark.parametrize(("encoding", "big", "padding"), [("16UC1", False, 0), ("16UC1", True, 4), ("32FC1", False, 8)])
def test_images_of_a_ros_topic_become_voxels(encoding: str, big: bool, padding: int, lab: Lab, node: Node) -> None:
    publisher = node.create_publisher(Image, TOPIC, qos_profile_sensor_data)
    lab.robot.perception.add(camera())
    masks: list[bytes] = []
    end = lab.bus.listen(KEYS.mask("front"), lambda _, payload: masks.append(payload))

    def seen() -> bool:
        lab.stand()
        publisher.publish(flat(0.8, encoding, big=big, padding=padding))
        return sum(len(one.cells) for one in lab.blocks.objects.values()) > 400 and len(masks) > 1

    eventually(
        seen,
        "the camera sees half a metre by forty centimetres, and it is shown what the map makes of small images too",
    )
    end()
    lab.expect_a_plane_below_the_camera()


def cloud(kind: str, *, big: bool = False) -> PointCloud2:
    """A square of points, 80 cm in front of the camera, as floats with a colour behind each."""
    x, y = np.meshgrid(np.linspace(-0.2, 0.2, 60), np.linspace(-0.15, 0.15, 45))
    points = np.zeros(x.size, np.dtype([(axis, kind) for axis in "xyz"] + [("rgb", "f4")]))
    points["x"], points["y"], points["z"] = x.ravel(), y.ravel(), 0.8
    if big:
        points = points.astype(points.dtype.newbyteorder(">"))
    size, code = (4, PointField.FLOAT32) if kind == "f4" else (8, PointField.FLOAT64)
    fields = [PointField(name=axis, offset=n * size, datatype=code, count=1) for n, axis in enumerate("xyz")]
    message = PointCloud2(
        height=45, width=60, fields=fields, is_bigendian=big, point_step=points.itemsize, row_step=60 * points.itemsize
    )
    message.data = points.tobytes()
    message.header.stamp = ros_time(time.time())
    return message


@pytest.mark.parametrize(("kind", "big"), [("f4", False), ("f8", False), ("f4", True)])
def test_clouds_of_a_ros_topic_become_voxels(kind: str, big: bool, lab: Lab, node: Node) -> None:
    publisher = node.create_publisher(PointCloud2, "/camera/points", qos_profile_sensor_data)
    clouds = {"topic": "/camera/points", "topic_type": "sensor_msgs/msg/PointCloud2"}
    lab.robot.perception.add(camera().model_copy(update=clouds))

    def seen() -> bool:
        lab.stand()
        publisher.publish(cloud(kind, big=big))
        return sum(len(one.cells) for one in lab.blocks.objects.values()) > 250

    eventually(seen, "the camera sees forty centimetres by thirty")
    lab.expect_a_plane_below_the_camera()


def test_planar_scans_of_a_ros_topic_become_voxels(lab: Lab, node: Node) -> None:
    publisher = node.create_publisher(LaserScan, "/scan", qos_profile_sensor_data)
    lab.robot.perception.add(
        Camera(
            name="scanner",
            position=(0.6, 0.7, 0.3),
            projection="spherical",
            topic="/scan",
            topic_type="sensor_msgs/msg/LaserScan",
            width=360,
            height=16,
            fx=57.3,
            fy=57.3,
            cx=179.5,
            cy=7.5,
        )
    )
    angles = np.radians(np.arange(-180.0, 180.0))
    wall = 0.2 / np.cos(angles)  # a wall, 20 cm before the scanner
    ranges = np.where((abs(angles) < 0.7), wall, np.inf)
    scan = LaserScan(
        angle_min=-np.pi, angle_max=np.pi, angle_increment=float(np.radians(1.0)), range_min=0.1, range_max=5.0,
        ranges=ranges.tolist(),
    )  # fmt: skip

    def seen() -> bool:
        lab.stand()
        scan.header.stamp = ros_time(time.time())
        publisher.publish(scan)
        return sum(len(one.cells) for one in lab.blocks.objects.values()) >= 15

    eventually(seen, "the scanner sees the wall")
    found = lab.blocks.objects.values()
    points = np.concatenate([np.array(one.cells) * one.resolution + one.position for one in found])
    np.testing.assert_allclose(points[:, 0], 0.8, atol=0.011)
    np.testing.assert_allclose(points[:, 2], 0.3, atol=0.011)
    assert np.ptp(points[:, 1]) > 0.25


def test_intrinsics_come_from_the_camera_info_beside_the_images(lab: Lab, node: Node) -> None:
    images = node.create_publisher(Image, TOPIC, qos_profile_sensor_data)
    infos = node.create_publisher(CameraInfo, "/camera/depth/camera_info", qos_profile_sensor_data)
    lab.robot.perception.add(Camera(name="front", position=(0.7, 0.7, 1.0), orientation=DOWN, topic=TOPIC))

    def problems() -> str:
        return " ".join(one.problem for one in lab.robot.perception.state().cameras)

    eventually(lambda: "no camera_info came" in problems(), "its intrinsics are missing")
    info = CameraInfo(width=64, height=48)
    info.k = [100.0, 0.0, 31.5, 0.0, 100.0, 23.5, 0.0, 0.0, 1.0]

    def seen() -> bool:
        lab.stand()
        infos.publish(info)
        images.publish(flat(0.8, "16UC1"))
        return sum(len(one.cells) for one in lab.blocks.objects.values()) > 400

    eventually(seen, "the camera sees half a metre by forty centimetres")
    assert lab.robot.perception.cameras()[0].intrinsics == (64, 48, 100.0, 100.0, 31.5, 23.5)
    info.k = [120.0, 0.0, 31.5, 0.0, 120.0, 23.5, 0.0, 0.0, 1.0]

    def zoomed() -> bool:
        infos.publish(info)
        return lab.robot.perception.cameras()[0].fx == 120.0

    eventually(zoomed, "the intrinsics have changed")


def test_a_camera_that_is_removed_is_listened_to_no_more(lab: Lab, node: Node) -> None:
    publisher = node.create_publisher(Image, TOPIC, qos_profile_sensor_data)
    lab.robot.perception.add(camera())
    eventually(lambda: publisher.get_subscription_count() == 1, "the bridge listens")
    lab.robot.perception.add(camera(topic="/another"))
    eventually(lambda: publisher.get_subscription_count() == 0, "the camera has another topic now")
    lab.robot.perception.add(camera())
    eventually(lambda: publisher.get_subscription_count() == 1, "the bridge listens again")
    lab.robot.perception.remove("front")
    eventually(lambda: publisher.get_subscription_count() == 0, "there is no camera")


def test_colour_images_of_a_ros_topic_reach_subscribers(lab: Lab, node: Node) -> None:
    publisher = node.create_publisher(Image, "/camera/color/image_rect", qos_profile_sensor_data)
    rows = np.zeros((48, 64 * 3 + 5), np.uint8)
    rows[:, 0 : 64 * 3 : 3] = 200  # blue
    message = Image(width=64, height=48, encoding="bgr8", step=rows.shape[1], data=rows.tobytes())

    def publish() -> None:
        message.header.stamp = ros_time(time.time())
        publisher.publish(message)

    timer = node.create_timer(0.05, publish)
    lab.robot.perception.add(camera(None).model_copy(update={"color_topic": "/camera/color/image_rect"}))
    try:
        image = lab.robot.perception.color("front", timeout=60.0)
    finally:
        node.destroy_timer(timer)
    assert image.shape == (48, 64, 3)
    assert (image == (0, 0, 200)).all()
