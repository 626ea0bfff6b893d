"""The cameras of a robot: where each is, and how its images are doing."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from zarm_contract.errors import InvalidRequest
from zarm_contract.image import decode_image
from zarm_contract.messages import Camera, CameraState, ImageHeader
from zarm_geometry.frames import matrix
from zarm_geometry.robot_model import RobotModel
from zarm_perception.kernels.integration import Depth, View

Array = NDArray[np.float64]

OLDEST, EARLIEST = 0.5, 0.02
"""An image may be this old (s) when it arrives, and stamped this far (s) in the future."""
SILENCE = 1.0
"""Without an image for this long (s), or for as long as five take, a camera does not see any more."""
COVERED = 0.02
"""An image of which less than this share has a depth shows nothing."""
_ALPHA = 0.1
"""Weight of the newest image in the mean of the times that images take."""


@dataclass(frozen=True)
class Image:
    """A depth image (h, w) in m, 0 or NaN where unknown, taken at `stamp` (Unix time, s)."""

    stamp: float
    depth: Depth


class CameraSource:
    """One camera, and how its images are doing. Raises InvalidRequest for a link that the robot has not."""

    def __init__(self, camera: Camera, model: RobotModel) -> None:
        self.camera = camera
        link = camera.link or model.robot.descriptor.base_link
        try:
            self._joint, mounted = model.mount(link)
        except (InvalidRequest, KeyError) as error:
            raise InvalidRequest(f"the robot has no link {link}; name one of its URDF", field="add.link") from error
        self._model, self._pose = model, mounted @ matrix(camera.position, camera.orientation)
        self._images, self._seen_at, self._stamp = 0, time.monotonic(), 0.0
        self._took, self._valid, self._robot = 0.0, 0.0, 0.0
        self._arrived = False
        self._fault = ""

    @property
    def moves(self) -> bool:
        """Whether the joints move it."""
        return self._joint >= 0

    def read(self, payload: bytes) -> Image | None:
        """The image in a payload, None for one that is not newer than the last. Raises InvalidRequest for one that cannot be used."""
        header, pixels = decode_image(payload)
        self._check(header)
        if header.stamp <= self._stamp:
            return None
        self._stamp = header.stamp
        kind = "<u2" if header.encoding == "16UC1" else "<f4"
        raw = np.frombuffer(pixels, kind).reshape(header.height, header.width)
        depth = raw.astype(np.float32) * np.float32(0.001) if kind == "<u2" else raw.astype(np.float32)
        return Image(header.stamp, depth)

    def _check(self, header: ImageHeader) -> None:
        camera = self.camera
        if (header.width, header.height) != (camera.width, camera.height):
            raise InvalidRequest(
                f"an image of {header.width} x {header.height} pixels, where the camera {camera.name} has {camera.width} x "
                f"{camera.height}; declare it as it is",
                field="width",
            )
        late = time.time() - header.stamp
        if late < -EARLIEST:
            raise InvalidRequest(
                f"the image is stamped {-late:.3f} s in the future; make the clocks agree within {EARLIEST:g} s",
                field="stamp",
            )
        if late > OLDEST:
            raise InvalidRequest(
                f"the image is {late:.3f} s old (at most {OLDEST:g} s); find out what delays it, and whether the clocks agree",
                field="stamp",
            )

    def view(self, joints: Array) -> View:
        """Where the camera is with the robot at joints (dof,)."""
        camera, pose = self.camera, self._pose
        if self.moves:
            pose = self._model.fk_joint(self._joint, joints) @ pose
        return View(
            camera.fx,
            camera.fy,
            camera.cx,
            camera.cy,
            np.ascontiguousarray(pose[:3, :3]),
            np.ascontiguousarray(pose[:3, 3]),
            camera.near,
            camera.far,
        )

    def taken(self, valid: float, robot: float, took: float) -> None:
        """An image was taken into the map: the shares of its pixels with a depth and of the robot, and how long that took (s)."""
        self._images += 1
        self._arrived = True
        if valid >= COVERED:
            self._seen_at = time.monotonic()
        self._valid, self._robot = valid, robot
        self._took += (took - self._took) * (_ALPHA if self._images > 1 else 1.0)
        self._fault = (
            "" if valid >= COVERED else f"only {100.0 * valid:.1f} % of its pixels have a depth: is it covered?"
        )

    def refused(self, why: str) -> None:
        """An image could not be used."""
        self._fault = why

    @property
    def _age(self) -> float:
        return time.monotonic() - self._seen_at

    @property
    def stale(self) -> bool:
        """Whether it has not seen for a while; a single image that cannot be used does not matter."""
        return self._age > max(SILENCE, 5.0 / self.camera.rate)

    @property
    def state(self) -> CameraState:
        """How its images are doing now."""
        age, problem = self._age, self._fault
        if self.stale and not problem:
            problem = f"no image for {age:.1f} s" if self._arrived else "no image yet"
        return CameraState(
            name=self.camera.name,
            images=self._images,
            age=age if self._arrived else None,
            took=self._took,
            valid=self._valid,
            robot=self._robot,
            problem=problem,
        )
