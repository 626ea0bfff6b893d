"""The cameras of the simulation: they see what is there, and publish it as real ones do."""

from __future__ import annotations

import logging
import threading
from functools import cache
from types import TracebackType
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from zarm_contract.image import encode_image
from zarm_contract.keys import Keys
from zarm_contract.messages import Camera, Cameras, ColorHeader, ImageHeader, Intrinsics
from zarm_physics_sim.arm import PhysicalArm
from zarm_physics_sim.simulation import Simulation
from zarm_runtime import clock
from zarm_runtime.bus import Bus

log = logging.getLogger(__name__)


_NEAR, _FAR = 0.02, 50.0
"""What is nearer or farther (m) is not seen at all."""
_MAX_DEPTH = 65.535
"""The greatest depth (m) of a pixel."""
_IDLE_PERIOD = 0.2
"""s until it is looked again whether there is a camera."""
_PREPARED = 3.0
"""Longest wait (s) for the renderers of another world."""


class CameraRenderer:
    """Renders images of one simulation. To be used in one thread."""

    def __init__(self, simulation: Simulation, width: int, height: int) -> None:
        self.simulation = simulation
        self._renderer: Any = simulation.renderer(width, height, _NEAR, _FAR)

    def close(self) -> None:
        """Give the graphics memory back."""
        self._renderer.close()

    def depth(self, camera: Camera, size: Intrinsics, data: Any) -> NDArray[np.uint16]:
        """The depths (h, w) in mm that a camera sees in the state `data`, 0 beyond what a pixel holds."""
        self._point(camera, size, data)
        self._renderer.enable_depth_rendering()
        return _millimetres(self._renderer.render())

    def color(self, camera: Camera, size: Intrinsics, data: Any) -> NDArray[np.uint8]:
        """Red, green and blue (h, w, 3) of what a camera sees in the state `data`."""
        self._point(camera, size, data)
        self._renderer.disable_depth_rendering()
        return np.asarray(self._renderer.render())

    def _point(self, camera: Camera, size: Intrinsics, data: Any) -> None:
        renderer = self._renderer
        place, turn = self.simulation.frame(data, camera.link, camera.position, camera.orientation)
        renderer.update_scene(data)
        for eye in renderer.scene.camera:
            eye.pos, eye.forward, eye.up = place, turn[:, 2], -turn[:, 1]
            eye.frustum_near, eye.frustum_far = _NEAR, _FAR
            left, right = -(size.cx + 0.5) / size.fx, (size.width - 0.5 - size.cx) / size.fx
            top, bottom = (size.cy + 0.5) / size.fy, -(size.height - 0.5 - size.cy) / size.fy
            eye.frustum_center, eye.frustum_width = 0.5 * (left + right) * _NEAR, 0.5 * (right - left) * _NEAR
            eye.frustum_top, eye.frustum_bottom = top * _NEAR, bottom * _NEAR


def ranges(simulation: Simulation, camera: Camera, size: Intrinsics, data: Any) -> NDArray[np.uint16]:
    """The ranges (h, w) in mm that a LiDAR measures in the state `data`, 0 where there is nothing."""
    place, turn = simulation.frame(data, camera.link, camera.position, camera.orientation)
    azimuth = (np.arange(size.width) - size.cx) / size.fx
    elevation = (size.cy - np.arange(size.height)) / size.fy
    level = np.cos(elevation)[:, None]
    forward, left = level * np.cos(azimuth), -level * np.sin(azimuth)
    up = np.broadcast_to(np.sin(elevation)[:, None], forward.shape)
    rays = np.stack((forward, left, up), axis=-1) @ turn.T
    return _millimetres(simulation.cast(data, place, rays.reshape(-1, 3), _FAR).reshape(rays.shape[:2]))


def _millimetres(depth: NDArray[np.floating[Any]]) -> NDArray[np.uint16]:
    return np.where((depth >= 0.0) & (depth < _MAX_DEPTH), np.rint(1000.0 * depth), 0.0).astype(np.uint16)


class ImagePublishers:
    """Publishes the images of each camera."""

    def __init__(self, bus: Bus, keys: Keys) -> None:
        self._depth = cache(lambda camera: bus.publisher(keys.depth(camera)))
        self._color = cache(lambda camera: bus.publisher(keys.color(camera)))

    def put_depth(self, camera: str, image: bytes) -> None:
        """Publish a depth image."""
        self._depth(camera).put_encoded(image)

    def put_color(self, camera: str, image: bytes) -> None:
        """Publish a colour image."""
        self._color(camera).put_encoded(image)

    def wants_color(self, camera: str) -> bool:
        """Whether anybody takes colour images of a camera; these cost ten times as much."""
        return bool(self._color(camera).has_subscribers())


class SimulatedCameras:
    """Renders each camera at its rate, in a thread of its own."""

    def __init__(self, arm: PhysicalArm, images: ImagePublishers) -> None:
        self._arm, self._images = arm, images
        self._cameras: tuple[Camera, ...] = ()
        self._changed = threading.Event()
        self._coming: Simulation | None = None
        self._prepared = threading.Event()
        self._ended = False
        self._thread = threading.Thread(target=self._run, name="cameras")

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._ended = True
        self._changed.set()
        self._thread.join()

    def receive(self, _key: str, cameras: Cameras) -> None:
        """These are the cameras from now on."""
        self._cameras = cameras.cameras
        self._changed.set()

    def prepare(self, simulation: Simulation) -> None:
        """Make renderers for a simulation before it takes the place of the present one: that takes the time of some images, in which a
        real camera would not be blind.
        """
        if self._thread.is_alive():
            self._prepared.clear()
            self._coming = simulation
            self._changed.set()
            self._prepared.wait(_PREPARED)

    def _run(self) -> None:
        renderers = _Renderers()
        due: dict[str, float] = {}
        try:
            while not self._ended:
                if (coming := self._coming) is not None:
                    self._coming = None
                    renderers.prepare(coming)
                    self._prepared.set()
                now, cameras = clock.monotonic(), self._cameras
                soon = [camera for camera in cameras if due.get(camera.name, now) <= now]
                for camera in soon:
                    due[camera.name] = max(due.get(camera.name, now), now - 1.0) + 1.0 / camera.rate
                    self._take(camera, renderers)
                next_due = min((due[camera.name] for camera in cameras), default=now + _IDLE_PERIOD)
                if self._changed.wait(clock.real_seconds(max(0.0, next_due - clock.monotonic()))):
                    self._changed.clear()
        except Exception:  # without a way to render, or out of graphics memory: the robot goes on
            log.exception("the cameras see nothing any more")
        finally:
            self._prepared.set()
            renderers.close()

    def _take(self, camera: Camera, renderers: _Renderers) -> None:
        size = camera.intrinsics
        if size is None:
            return
        if camera.projection == "spherical":
            simulation, data, stamp = self._arm.picture()
            pixels = ranges(simulation, camera, size, data)
        else:
            known = renderers.of(self._arm.simulation, (size.width, size.height))
            simulation, data, stamp = self._arm.picture()
            if simulation is not known.simulation:  # the world has changed meanwhile
                return
            pixels = known.depth(camera, size, data)
            if self._images.wants_color(camera.name):
                colors = known.color(camera, size, data)
                about = ColorHeader(stamp=stamp, width=size.width, height=size.height, encoding="rgb8")
                self._images.put_color(camera.name, encode_image(about, colors.tobytes()))
        header = ImageHeader(stamp=stamp, width=size.width, height=size.height, encoding="16UC1")
        self._images.put_depth(camera.name, encode_image(header, pixels.tobytes()))


class _Renderers:
    """Renderers by the size of images, those in use and those for a simulation to come."""

    def __init__(self) -> None:
        self._used: dict[tuple[int, int], CameraRenderer] = {}
        self._spare: dict[tuple[int, int], CameraRenderer] = {}

    def prepare(self, simulation: Simulation) -> None:
        """Make those for a simulation to come."""
        for shape in self._used:
            if (unused := self._spare.pop(shape, None)) is not None:
                unused.close()
            self._spare[shape] = CameraRenderer(simulation, *shape)

    def of(self, simulation: Simulation, shape: tuple[int, int]) -> CameraRenderer:
        """The one for images of a shape (w, h)."""
        used = self._used.get(shape)
        if used is None or used.simulation is not simulation:
            if used is not None:
                used.close()
            ready = self._spare.pop(shape, None)
            if ready is not None and ready.simulation is not simulation:
                ready.close()
                ready = None
            used = self._used[shape] = ready or CameraRenderer(simulation, *shape)
        return used

    def close(self) -> None:
        """Give their graphics memory back."""
        for renderer in (*self._used.values(), *self._spare.values()):
            renderer.close()
