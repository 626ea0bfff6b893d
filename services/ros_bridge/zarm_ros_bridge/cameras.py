"""Depth images of ROS cameras for the voxel map."""

from __future__ import annotations

import logging
import threading
from typing import Any

import numpy as np
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import Image

from zarm_contract.image import PIXEL_BYTES, encode_image
from zarm_contract.messages import Camera, Cameras, ImageHeader
from zarm_ros_bridge.engine import Engine
from zarm_ros_bridge.ros import Ros

log = logging.getLogger(__name__)


class CameraTopics:
    """Passes the images of each camera that has a topic on ROS to the perception, from cameras that are added later too."""

    def __init__(self, ros: Ros, engine: Engine) -> None:
        self._ros, self._engine = ros, engine
        self._turn = threading.Lock()
        self._topics: dict[str, tuple[str, Any]] = {}
        engine.bus.watch(engine.keys.cameras, self._changed)

    def _changed(self, _key: str, cameras: Cameras) -> None:
        wanted = {camera.name: camera.topic for camera in cameras.cameras if camera.topic}
        with self._turn:
            for name, (topic, subscription) in [*self._topics.items()]:
                if wanted.get(name) != topic:
                    self._ros.node.destroy_subscription(subscription)
                    del self._topics[name]
            for camera in cameras.cameras:
                if camera.topic and camera.name not in self._topics:
                    self._topics[camera.name] = camera.topic, self._subscription(camera, camera.topic)

    def _subscription(self, camera: Camera, topic: str) -> Any:
        publisher = self._engine.client.connection.publisher(self._engine.keys.depth(camera.name))
        refused = ""

        def receive(image: Image) -> None:
            nonlocal refused
            try:
                publisher.put_encoded(_encoded(image))
            except ValueError as error:
                if str(error) != refused:
                    refused = str(error)
                    log.warning("an image cannot be used topic=%s reason=%s", topic, error)

        return self._ros.node.create_subscription(
            Image, topic, receive, qos_profile_sensor_data, callback_group=MutuallyExclusiveCallbackGroup()
        )


def _encoded(image: Image) -> bytes:
    """The image as the perception reads it. Raises ValueError."""
    if image.encoding not in PIXEL_BYTES:
        raise ValueError(f"the encoding {image.encoding!r} is no depth; publish {' or '.join(PIXEL_BYTES)}")
    wide = image.width * PIXEL_BYTES[image.encoding]
    if image.step < wide or len(image.data) != image.step * image.height:
        raise ValueError(f"{len(image.data)} bytes are not {image.height} rows of {image.step}")
    rows = np.frombuffer(image.data, np.uint8).reshape(image.height, image.step)[:, :wide]
    if image.is_bigendian:
        rows = rows.reshape(image.height, image.width, -1)[:, :, ::-1]
    stamp = image.header.stamp
    header = ImageHeader.model_validate(
        {
            "stamp": stamp.sec + stamp.nanosec * 1e-9,
            "width": image.width,
            "height": image.height,
            "encoding": image.encoding,
        }
    )
    return encode_image(header, rows.tobytes())
