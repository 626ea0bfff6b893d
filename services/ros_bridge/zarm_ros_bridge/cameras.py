"""Depth images, clouds and colour images of ROS cameras."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple, Self, TypeVar

import numpy as np
from numpy.typing import NDArray
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import CameraInfo, Image, LaserScan, PointCloud2, PointField

from zarm_contract.errors import ZarmError
from zarm_contract.image import COLOR_BYTES, PIXEL_BYTES, encode_image
from zarm_contract.messages import Camera, Cameras, CloudHeader, ColorHeader, ImageHeader, Intrinsics
from zarm_ros_bridge.engine import Engine
from zarm_ros_bridge.ros import Ros

log = logging.getLogger(__name__)

T = TypeVar("T", Image, LaserScan, PointCloud2)

_FLOATS = {PointField.FLOAT32: "f4", PointField.FLOAT64: "f8"}


class _Topics(NamedTuple):
    """What is subscribed to for a camera."""

    depth: str | None
    depth_type: str
    color: str | None

    @classmethod
    def of(cls, camera: Camera) -> Self:
        return cls(camera.topic, camera.topic_type, camera.color_topic)


class CameraTopics:
    """Passes the images or clouds of each camera that has a topic on ROS to the perception, from cameras that are added later too,
    and its colour images to those who take them. Intrinsics that a camera leaves out are those of its `camera_info`.
    """

    def __init__(self, ros: Ros, engine: Engine) -> None:
        self._ros, self._engine = ros, engine
        self._turn = threading.Lock()
        self._cameras: dict[str, Camera] = {}
        self._topics: dict[str, tuple[_Topics, list[Any]]] = {}
        engine.bus.watch(engine.keys.cameras, self._changed)

    def _changed(self, _key: str, cameras: Cameras) -> None:
        with self._turn:
            self._cameras = {camera.name: camera for camera in cameras.cameras}
            wanted = {camera.name: _Topics.of(camera) for camera in cameras.cameras}
            for name, (topics, subscriptions) in [*self._topics.items()]:
                if wanted.get(name) != topics:
                    for subscription in subscriptions:
                        self._ros.node.destroy_subscription(subscription)
                    del self._topics[name]
            for camera in cameras.cameras:
                if camera.name not in self._topics:
                    self._topics[camera.name] = wanted[camera.name], [*self._subscriptions(camera)]

    def _subscriptions(self, camera: Camera) -> Iterator[Any]:
        if camera.topic is not None:
            yield from self._depth_subscriptions(camera, camera.topic)
        if camera.color_topic is not None:
            colors = self._engine.client.connection.publisher(self._engine.keys.color(camera.name))
            yield self._subscription(Image, camera.color_topic, colors.put_encoded, _color, colors.has_subscribers)

    def _depth_subscriptions(self, camera: Camera, topic: str) -> Iterator[Any]:
        client, keys = self._engine.client, self._engine.keys
        if camera.topic_type != "sensor_msgs/msg/Image":
            clouds = client.connection.publisher(keys.cloud(camera.name))
            if camera.topic_type == "sensor_msgs/msg/LaserScan":
                yield self._subscription(LaserScan, topic, clouds.put_encoded, _scan)
            else:
                yield self._subscription(PointCloud2, topic, clouds.put_encoded, _cloud)
            return
        images = client.connection.publisher(keys.depth(camera.name))
        yield self._subscription(Image, topic, images.put_encoded, _image)
        if camera.intrinsics is None:
            info_topic = f"{topic.rpartition('/')[0]}/camera_info"
            yield self._ros.node.create_subscription(
                CameraInfo,
                info_topic,
                lambda info: self._informed(camera.name, info_topic, info),
                qos_profile_sensor_data,
                callback_group=MutuallyExclusiveCallbackGroup(),
            )

    def _subscription(
        self,
        kind: type[T],
        topic: str,
        publish: Callable[[bytes], object],
        encode: Callable[[T], bytes],
        wanted: Callable[[], bool] = lambda: True,
    ) -> Any:
        refused = ""

        def receive(message: T) -> None:
            nonlocal refused
            if not wanted():
                return
            try:
                publish(encode(message))
            except ValueError as error:
                if str(error) != refused:
                    refused = str(error)
                    log.warning("an image cannot be used topic=%s reason=%s", topic, error)

        return self._ros.node.create_subscription(
            kind, topic, receive, qos_profile_sensor_data, callback_group=MutuallyExclusiveCallbackGroup()
        )

    def _informed(self, name: str, topic: str, info: CameraInfo) -> None:
        """Complete the camera by its intrinsics, at first and when they change."""
        camera = self._cameras.get(name)
        if camera is None:
            return
        size = Intrinsics(info.width, info.height, info.k[0], info.k[4], info.k[2], info.k[5])
        if size == camera.intrinsics:
            return
        if any(info.d):
            log.warning("the intrinsics cannot be used topic=%s reason=images are distorted; rectify them", topic)
            return
        try:
            self._engine.client.perception.add(Camera.model_validate({**camera.model_dump(), **size._asdict()}))
        except (ZarmError, ValueError) as error:
            log.warning("the intrinsics cannot be used topic=%s reason=%s", topic, error)


def _image(image: Image) -> bytes:
    """The image as the perception reads it. Raises ValueError."""
    if image.encoding not in PIXEL_BYTES:
        raise ValueError(f"the encoding {image.encoding!r} is no depth; publish {' or '.join(PIXEL_BYTES)}")
    pixels = _pixels(image, PIXEL_BYTES[image.encoding])
    if image.is_bigendian:
        pixels = pixels[:, :, ::-1]
    header = ImageHeader.model_validate({**_described(image), "encoding": image.encoding})
    return encode_image(header, pixels.tobytes())


def _color(image: Image) -> bytes:
    """The colour image as it is on the bus. Raises ValueError."""
    encoding = "rgb8" if image.encoding == "bgr8" else image.encoding
    if encoding not in COLOR_BYTES:
        raise ValueError(f"the encoding {image.encoding!r} is not known; publish bgr8, {' or '.join(COLOR_BYTES)}")
    pixels = _pixels(image, COLOR_BYTES[encoding])
    if image.encoding == "bgr8":
        pixels = pixels[:, :, ::-1]
    return encode_image(ColorHeader.model_validate({**_described(image), "encoding": encoding}), pixels.tobytes())


def _pixels(image: Image, size: int) -> NDArray[np.uint8]:
    """The pixels (h, w, size) of an image whose pixels have so many bytes. Raises ValueError."""
    wide = image.width * size
    if image.step < wide or len(image.data) != image.step * image.height:
        raise ValueError(f"{len(image.data)} bytes are not {image.height} rows of {image.step}")
    rows = np.frombuffer(image.data, np.uint8).reshape(image.height, image.step)[:, :wide]
    return rows.reshape(image.height, image.width, size)


def _described(image: Image) -> dict[str, object]:
    stamp = image.header.stamp
    return {"stamp": stamp.sec + stamp.nanosec * 1e-9, "width": image.width, "height": image.height}


def _cloud(cloud: PointCloud2) -> bytes:
    """The cloud as the perception reads it. Raises ValueError."""
    formats = {field.name: field for field in cloud.fields}
    order = ">" if cloud.is_bigendian else "<"
    if not {"x", "y", "z"} <= {*formats} or any(formats[axis].datatype not in _FLOATS for axis in "xyz"):
        raise ValueError("a cloud needs the fields x, y and z of type FLOAT32 or FLOAT64")
    kind = np.dtype(
        {
            "names": ["x", "y", "z"],
            "formats": [order + _FLOATS[formats[axis].datatype] for axis in "xyz"],
            "offsets": [formats[axis].offset for axis in "xyz"],
            "itemsize": cloud.point_step,
        }
    )
    wide = cloud.width * cloud.point_step
    if cloud.row_step < wide or len(cloud.data) != cloud.row_step * cloud.height:
        raise ValueError(f"{len(cloud.data)} bytes are not {cloud.height} rows of {cloud.row_step}")
    rows = np.frombuffer(cloud.data, np.uint8).reshape(cloud.height, cloud.row_step)[:, :wide]
    found = np.frombuffer(rows.tobytes(), kind)
    points = np.column_stack([found[axis] for axis in "xyz"]).astype("<f4")
    stamp = cloud.header.stamp
    header = CloudHeader(stamp=stamp.sec + stamp.nanosec * 1e-9, points=len(points))
    return encode_image(header, points.tobytes())


def _scan(scan: LaserScan) -> bytes:
    """The points of a planar scan as the perception reads them: those in range, with x forward and z up."""
    ranges = np.asarray(scan.ranges, np.float64)
    angles = scan.angle_min + scan.angle_increment * np.arange(len(ranges))
    seen = (ranges >= scan.range_min) & (ranges <= scan.range_max)
    flat = np.column_stack((np.cos(angles), np.sin(angles), np.zeros(len(ranges))))
    points = (ranges[:, None] * flat)[seen].astype("<f4")
    stamp = scan.header.stamp
    header = CloudHeader(stamp=stamp.sec + stamp.nanosec * 1e-9, points=len(points))
    return encode_image(header, points.tobytes())
