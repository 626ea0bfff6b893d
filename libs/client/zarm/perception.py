"""The cameras of a robot, and the voxel map that is made of them."""

from __future__ import annotations

import time
from base64 import b64decode
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from zarm.calls import Calls
from zarm.clusters import boxes_around
from zarm.live import Newest
from zarm.values import made
from zarm_contract.codec import decode, encode
from zarm_contract.errors import InvalidRequest, Unavailable
from zarm_contract.image import PIXEL_BYTES, decode_color, encode_image
from zarm_contract.messages import (
    Camera,
    CameraChange,
    CloudHeader,
    ColorHeader,
    Cuboid,
    ImageHeader,
    LoadedMap,
    Nothing,
    PerceptionState,
    SavedMap,
    Vector3,
    VoxelBlock,
)
from zarm_contract.messages.perception import BLOCK

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import ArrayLike, NDArray


class Perception(Calls):
    """The perception of a robot that runs with `zarm up --perception`."""

    def cameras(self) -> tuple[Camera, ...]:
        """The depth cameras there are."""
        return self._ask(self._keys.cameras, CameraChange()).cameras

    def add(self, camera: Camera) -> tuple[Camera, ...]:
        """Add a camera, or replace the one with its name. Returns all of them."""
        return self._ask(self._keys.cameras, CameraChange(add=camera)).cameras

    def remove(self, camera: str) -> tuple[Camera, ...]:
        """Remove a camera by name; what it has seen stays. Returns the others."""
        return self._ask(self._keys.cameras, CameraChange(remove=camera)).cameras

    def publish(
        self, camera: str, stamp: float, pixels: bytes, *, width: int, height: int, encoding: str = "16UC1"
    ) -> None:
        """Publish a depth image that was taken at `stamp` (Unix time, s): rows of `16UC1` (mm) or `32FC1` (m) in little-endian.

        ```python
        depth = numpy.asarray(frame.get_data())  # (480, 640), uint16, mm
        robot.perception.publish("wrist", time.time(), depth.tobytes(), width=640, height=480)
        ```
        """
        if encoding not in PIXEL_BYTES:
            raise InvalidRequest(
                f"{encoding} is no encoding of depth; use {' or '.join(PIXEL_BYTES)}", field="encoding"
            )
        header = ImageHeader.model_validate({"stamp": stamp, "width": width, "height": height, "encoding": encoding})
        self.connection.publisher(self._keys.depth(camera)).put_encoded(encode_image(header, pixels))

    def publish_color(self, camera: str, stamp: float, pixels: ArrayLike) -> None:
        """Publish an image, registered to the depth, that was taken at `stamp` (Unix time, s): bytes of grey (h, w) or of red, green and blue (h, w, 3)."""
        import numpy as np

        found = np.ascontiguousarray(pixels)
        if found.dtype != np.uint8 or found.ndim not in (2, 3) or found.shape[2:] not in ((), (3,)):
            raise InvalidRequest(
                f"{found.dtype} of the shape {found.shape}; give bytes, (h, w) or (h, w, 3)", field="pixels"
            )
        encoding = "mono8" if found.ndim == 2 else "rgb8"
        header = made(ColorHeader, stamp=stamp, width=found.shape[1], height=found.shape[0], encoding=encoding)
        self.connection.publisher(self._keys.color(camera)).put_encoded(encode_image(header, found.tobytes()))

    def color(self, camera: str, *, after: float = 0.0, timeout: float = 10.0) -> NDArray[np.uint8]:
        """The next colour image of a camera that was taken after a Unix time (s): bytes of grey (h, w), or of red, green and blue (h, w, 3). Raises Unavailable if
        none comes within `timeout` s.
        """
        newest: Newest[bytes] = Newest()
        end = self.connection.bus.listen(self._keys.color(camera), lambda _, payload: newest.put(payload))
        until = time.monotonic() + timeout
        try:
            while (left := until - time.monotonic()) > 0.0:
                payload = self.connection.interrupts.run_interruptibly(partial(newest.take, left))
                if payload is None:
                    break
                stamp, image = color_image(payload)
                if stamp > after:
                    return image
        finally:
            end()
        raise Unavailable(
            f"no colour image of the camera {camera} came within {timeout:g} s; let it publish them on perception/color/{camera}"
        )

    def publish_cloud(self, camera: str, stamp: float, points: ArrayLike) -> None:
        """Publish a cloud that was taken at `stamp` (Unix time, s): points (n, 3) in m, in the frame of the camera or LiDAR."""
        import numpy as np

        found = np.ascontiguousarray(points, "<f4")
        if found.ndim != 2 or found.shape[1] != 3:
            raise InvalidRequest(f"points of the shape {found.shape}; give (n, 3)", field="points")
        header = made(CloudHeader, stamp=stamp, points=len(found))
        self.connection.publisher(self._keys.cloud(camera)).put_encoded(encode_image(header, found.tobytes()))

    def look(self, *, images: int = 5, timeout: float = 10.0) -> PerceptionState:
        """Wait until each camera has given so many more images, so that the map is what they see now. Raises Unavailable after `timeout` s, which says what is
        wrong with a camera that has not.
        """
        until, before = time.monotonic() + timeout, dict[str, int]()
        missing = f"the perception of {self.name} says nothing; start it with `zarm up --perception`"
        while (left := until - time.monotonic()) > 0.0:
            state = self.connection.next(self._keys.perception_state, left)
            if state is None:
                break
            late = [
                camera
                for camera in state.cameras
                if camera.images < before.setdefault(camera.name, camera.images) + images
            ]
            if state.cameras and not late:
                return state
            missing = "there is no camera; add one first"
            if late:
                missing = f"the camera {late[0].name} has not given {images} images in {timeout:g} s"
                missing += f": {late[0].problem}" if late[0].problem else ""
        raise Unavailable(missing)

    def boxes(self, *, floor: float | None = None, largest: float = 0.3, prefix: str = "box") -> list[Cuboid]:
        """The things in the voxel map as boxes that stand upright, named `box_0`, `box_1` and so on, from the one with most voxels on.

        A thing is a cluster of occupied voxels that touch each other and no other; its box contains these, and is turned about z so that it is small. With
        `floor` (m, base frame) boxes reach down to there, where cameras do not see. Clusters longer than `largest` (m) are left out.

        ```python
        for box in robot.perception.boxes(floor=0.0):
            robot.scene.add(box)
        ```
        """
        return boxes_around(self.points(), self.state().resolution, largest, floor, prefix)

    def points(self) -> list[Vector3]:
        """The centres of the occupied voxels (m, base frame)."""
        import numpy as np

        blocks: dict[str, VoxelBlock] = {}

        def read() -> None:
            self.connection.bus.watch(self._keys.voxels("*"), lambda key, block: blocks.update({key: block}))()

        self.connection.interrupts.run_interruptibly(read)
        found: list[Vector3] = []
        for block in blocks.values():
            bits = np.unpackbits(np.frombuffer(b64decode(block.cells), np.uint8)).reshape(-1, BLOCK, BLOCK)
            found += map(tuple, (np.argwhere(bits) * block.resolution + block.position).tolist())
        return found

    def clear(self) -> None:
        """Forget what the cameras have seen."""
        self._ask(self._keys.perception_clear, Nothing())

    def save(self, path: str | Path) -> None:
        """Save the voxel map in a file."""
        saved = encode(self._ask(self._keys.perception_save, Nothing()))
        try:
            Path(path).write_bytes(saved)
        except OSError as error:
            raise InvalidRequest(f"{path}: {error.strerror}; name a file that can be written", field="path") from error

    def load(self, path: str | Path) -> LoadedMap:
        """Make a map that was saved the voxel map; cameras change it from then on. Returns how many of its voxels are occupied."""
        try:
            saved = decode(SavedMap, Path(path).read_bytes())
        except OSError as error:
            raise InvalidRequest(f"{path}: {error.strerror}; name a file that was saved", field="path") from error
        except InvalidRequest as error:
            raise InvalidRequest(f"{path} is no saved map; name a file that was saved", field="path") from error
        return self._ask(self._keys.perception_load, saved)

    def state(self) -> PerceptionState:
        """What the cameras see, and whether they do."""
        return self.connection.read(self._keys.perception_state)


def color_image(payload: bytes) -> tuple[float, NDArray[np.uint8]]:
    """When a colour image on the bus was taken (Unix time, s), and its pixels: (h, w) of grey, or (h, w, 3). Raises InvalidRequest."""
    import numpy as np

    header, pixels = decode_color(payload)
    image = np.frombuffer(pixels, np.uint8)
    return header.stamp, image.reshape((header.height, header.width, 3)[: 2 if header.encoding == "mono8" else 3])
