"""Turns images into the voxel map, and publishes what changes."""

from __future__ import annotations

import logging
import math
import threading
import time
from collections.abc import Callable
from types import TracebackType
from typing import Self

import numpy as np

from zarm_contract.errors import InvalidRequest, ZarmError
from zarm_contract.image import encode_image
from zarm_contract.messages import (
    Camera,
    CameraChange,
    Cameras,
    ColorHeader,
    LoadedMap,
    Nothing,
    PerceptionState,
    SavedMap,
    Scene,
    VoxelBlock,
)
from zarm_contract.messages.perception import MAX_CAMERAS
from zarm_geometry.gripper_openings import GripperOpenings
from zarm_geometry.robot_model import RobotModel
from zarm_perception.blocks import Blocks
from zarm_perception.cameras import CameraSource, Image
from zarm_perception.joint_history import JointHistory
from zarm_perception.robot_shape import RobotShapes
from zarm_perception.saved_map import load, save
from zarm_perception.voxel_map import Seen, VoxelMap
from zarm_runtime import clock

log = logging.getLogger(__name__)

_PATIENCE = 0.1
"""How long (s) an image waits for the joints at its stamp."""
_STATE_PERIOD = 0.5
"""s between two states."""


class Mapping:
    """The voxel map of a robot: takes images from any thread, one after the other, the newest of each camera.

    `publish(block, message)` is called for each block that has changed, `report(state)` twice a second, and as often
    `show(camera, payload)` for what it makes of an image.
    """

    def __init__(
        self,
        model: RobotModel,
        voxels: VoxelMap,
        padding: float,
        history: JointHistory,
        grippers: GripperOpenings,
        publish: Callable[[str, VoxelBlock], object],
        report: Callable[[PerceptionState], object],
        show: Callable[[str, bytes], object],
    ) -> None:
        self._model, self._voxels, self._padding = model, voxels, padding
        self._history, self._grippers = history, grippers
        self._publish, self._report, self._show = publish, report, show
        self._shown_at: dict[str, float] = {}
        self._sources: dict[str, CameraSource] = {}
        self._waiting: dict[str, tuple[CameraSource, Image]] = {}
        self._unknown: set[str] = set()
        self._scene = Scene(revision="0-000000000000")
        self._shapes: tuple[tuple[object, ...], RobotShapes] | None = None
        self._blocks = Blocks(voxels)
        self._lock = threading.Lock()
        self._map_lock = threading.Lock()
        self._news = threading.Event()
        self._ended = False
        self._thread = threading.Thread(target=self._run, name="mapping")

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._ended = True
        self._news.set()
        self._thread.join()

    @property
    def alive(self) -> bool:
        """Whether images are still taken."""
        return self._thread.is_alive()

    # -- what comes in, from any thread --

    def change(self, change: CameraChange) -> Cameras:
        """Add or remove a camera. Raises InvalidRequest."""
        with self._lock:
            if change.add is not None:
                self.add(change.add)
            if change.remove is not None:
                if change.remove not in self._sources:
                    known = ", ".join(self._sources) or "none"
                    raise InvalidRequest(f"there is no camera {change.remove}; there are {known}", field="remove")
                self._sources = {name: one for name, one in self._sources.items() if name != change.remove}
            return self.cameras

    def add(self, camera: Camera) -> None:
        """Add a camera, or replace the one with its name. Raises InvalidRequest."""
        if len({*self._sources, camera.name}) > MAX_CAMERAS:
            raise InvalidRequest(f"at most {MAX_CAMERAS} cameras; remove one first", field="add")
        self._sources = {**self._sources, camera.name: CameraSource(camera, self._model)}

    @property
    def cameras(self) -> Cameras:
        """The cameras there are."""
        return Cameras(cameras=tuple(source.camera for source in self._sources.values()))

    def on_scene(self, _key: str, scene: Scene) -> None:
        """Take what the robot carries."""
        self._scene = scene

    def on_image(self, key: str, payload: bytes) -> None:
        """Take a depth image on the key of its camera."""
        self._receive(key, payload, CameraSource.read)

    def on_cloud(self, key: str, payload: bytes) -> None:
        """Take a cloud on the key of its camera."""
        self._receive(key, payload, CameraSource.read_cloud)

    def _receive(self, key: str, payload: bytes, read: Callable[[CameraSource, bytes], Image | None]) -> None:
        name = key.rpartition("/")[2]
        source = self._sources.get(name)
        if source is None:
            if name not in self._unknown and len(self._unknown) < MAX_CAMERAS:
                self._unknown.add(name)
                log.warning("images are dropped camera=%s reason=no_such_camera", name)
            return
        try:
            image = read(source, payload)
        except InvalidRequest as error:
            source.refused(str(error))
            return
        if image is not None:
            with self._lock:
                self._waiting[name] = source, image
            self._news.set()

    def clear(self, _: Nothing) -> Nothing:
        """Forget what was seen."""
        with self._map_lock:
            self._voxels.forget()
            self._publish_changes()
        return Nothing()

    def save(self, _: Nothing) -> SavedMap:
        """The map, to be saved."""
        with self._map_lock:
            return save(self._voxels)

    def load(self, saved: SavedMap) -> LoadedMap:
        """Make a saved map the map. Raises InvalidRequest."""
        with self._map_lock:
            loaded = load(self._voxels, saved)
            self._publish_changes()
        return loaded

    # -- the map, in a thread of its own --

    def _run(self) -> None:
        due = clock.monotonic()
        while not self._ended:
            if self._news.wait(clock.real_seconds(max(0.0, due - clock.monotonic()))):
                self._news.clear()
                with self._lock:
                    images, self._waiting = self._waiting, {}
                for name, (source, image) in images.items():
                    try:
                        self._take(source, image)
                    except Exception as error:  # if this ended, the map would silently be old
                        log.exception("an image is not in the map camera=%s", name)
                        source.refused(f"a fault of zarm, see the log: {error}")
            if clock.monotonic() >= due:
                due = clock.monotonic() + _STATE_PERIOD
                self._report(self._state())

    def _take(self, source: CameraSource, image: Image) -> None:
        joints = self._history.at(image.stamp, _PATIENCE)
        if joints is None:
            source.refused("the joints at the time of its image are unknown: are the clocks the same?")
            return
        try:
            robot = self._robot().at(joints)
        except ZarmError as error:  # it carries something where it has no link
            source.refused(f"the robot cannot be left out: {error}")
            return
        begun = time.perf_counter()
        with self._map_lock:
            if self._sources.get(source.camera.name) is not source:
                return  # it was removed, or replaced, and the map perhaps cleared since then
            seen = self._voxels.integrate(image.depth, source.view(joints), robot, self._padding)
            self._publish_changes()
        pixels = image.depth.size
        source.taken(seen.valid / pixels, seen.robot / pixels, time.perf_counter() - begun)
        self._show_mask(source.camera.name, image.stamp, seen)

    def _show_mask(self, camera: str, stamp: float, seen: Seen) -> None:
        now = clock.monotonic()
        if now - self._shown_at.get(camera, -math.inf) >= _STATE_PERIOD:
            self._shown_at[camera] = now
            mask = seen.mask()
            height, width = mask.shape
            header = ColorHeader(stamp=stamp, width=width, height=height, encoding="mono8")
            self._show(camera, encode_image(header, mask.tobytes()))

    def _robot(self) -> RobotShapes:
        """The robot with what it carries, its grippers as they are, and what it may grip."""
        scene, openings = self._scene, self._grippers.present()
        key = (scene.revision, openings)
        if self._shapes is None or self._shapes[0] != key:
            model = self._model.with_attached(scene.carried, (), openings)
            self._shapes = key, RobotShapes(model, scene.objects)
            with self._map_lock:
                self._voxels.take_out(self._shapes[1].things, self._padding)
        return self._shapes[1]

    def _publish_changes(self) -> None:
        for name, block in self._blocks.changed():
            self._publish(name, block)

    def _state(self) -> PerceptionState:
        sources = tuple(self._sources.values())
        cameras = tuple(source.state for source in sources)
        voxels = self._voxels
        (a, b, c), (x, y, z) = voxels.lower.tolist(), voxels.upper.tolist()
        return PerceptionState(
            cameras=cameras,
            lower=(a, b, c),
            upper=(x, y, z),
            resolution=voxels.resolution,
            padding=self._padding,
            unseen="occupied" if voxels.unseen_occupied else "free",
            occupied=int(np.count_nonzero(voxels.occupied)),
            stale=any(source.stale for source in sources),
            stamp=clock.unix_time(),
        )
