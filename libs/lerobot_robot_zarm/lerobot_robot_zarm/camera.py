"""The colour images of zarm's cameras for LeRobot."""

from __future__ import annotations

import threading
from contextlib import ExitStack
from typing import Any

import numpy as np
from lerobot.cameras import Camera
from numpy.typing import NDArray

import zarm
from lerobot_robot_zarm.config import ZarmCameraConfig
from zarm.perception import color_image

_IMAGE_TIMEOUT = 2.0
"""Longest wait (s) for an image."""


class ZarmCamera(Camera):
    """A camera that publishes colour images on the bus, as one of ROS through the bridge or of a simulation with physics."""

    def __init__(self, config: ZarmCameraConfig) -> None:
        super().__init__(config)
        self._config = config
        self._stack = ExitStack()
        self._robot: zarm.Robot | None = None
        self._newest: bytes | None = None
        self._came = threading.Condition()

    @property
    def is_connected(self) -> bool:
        """Whether it is connected."""
        return self._robot is not None

    @staticmethod
    def find_cameras() -> list[dict[str, Any]]:
        """None: a bus is named first."""
        return []

    def connect(self, warmup: bool = True) -> None:
        """Connect. Raises zarm.Unavailable without a router; with `warmup` also if no image comes."""
        if self._robot is None:
            robot = self._robot = self._stack.enter_context(zarm.connect(self._config.connect, self._config.name))
            bus, keys = robot.connection.bus, robot.connection.keys
            self._stack.callback(bus.listen(keys.color(self._config.camera), self._take))
        if warmup:
            self.read()

    def read(self, color_mode: Any = None) -> NDArray[np.uint8]:
        """An image that comes from now on: red, green and blue (h, w, 3). Raises what `async_read` raises."""
        with self._came:
            self._newest = None
        return self.async_read(1000.0 * _IMAGE_TIMEOUT)

    def async_read(self, timeout_ms: float = 1000.0 * _IMAGE_TIMEOUT) -> NDArray[np.uint8]:
        """The newest image (h, w, 3), at once if there is one: a policy must not wait for a slow camera. Raises ConnectionError before it is connected,
        zarm.Unavailable if none comes in time, and InvalidRequest for one of another size than stated.
        """
        if self._robot is None:
            raise ConnectionError(f"the camera {self._config.camera} is not connected; call connect() first")
        with self._came:
            self._came.wait_for(lambda: self._newest is not None, timeout_ms / 1000.0)
            payload = self._newest
        if payload is None:
            raise zarm.Unavailable(f"no colour image of {self._config.camera} came within {timeout_ms:g} ms")
        _, image = color_image(payload)
        if image.ndim == 2:
            image = np.repeat(image[:, :, None], 3, axis=2)
        height, width = image.shape[:2]
        if (self.width, self.height) not in ((None, None), (width, height)):
            raise zarm.InvalidRequest(
                f"images of {self._config.camera} have {width} x {height} pixels; say so, not {self.width} x {self.height}",
                field="width",
            )
        return image

    def disconnect(self) -> None:
        """Disconnect."""
        self._robot = self._newest = None
        self._stack.close()

    def _take(self, _key: str, payload: bytes) -> None:
        with self._came:
            self._newest = payload
            self._came.notify_all()
