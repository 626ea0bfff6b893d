"""The cameras of a robot: where each is, and how its images are doing."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from zarm_contract.errors import InvalidRequest
from zarm_contract.image import decode_cloud, decode_image
from zarm_contract.messages import Camera, CameraState, Intrinsics
from zarm_geometry.frames import matrix
from zarm_geometry.robot_model import RobotModel
from zarm_perception.kernels.integration import Depth, View, project
from zarm_runtime import clock
from zarm_trajectory.arrays import Array

OLDEST, EARLIEST = 0.5, 0.02
"""An image may be this old (s) when it arrives, and stamped this far (s) in the future."""
SILENCE = 1.0
"""Without an image for this long (s), or for as long as five take, a camera does not see any more."""
COVERED = 0.02
"""An image of which less than this share has a depth shows nothing."""
_SEAM = 0.5
"""What a view all around shows twice on either side (rad): so large may a voxel behind it appear."""
_OPTICAL = np.array([[0.0, 0.0, 1.0, 0.0], [-1.0, 0.0, 0.0, 0.0], [0.0, -1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
"""An optical frame in one with x forward, y left and z up."""
_ALPHA = 0.1
"""Weight of the newest image in the mean of the times that images take."""


@dataclass(frozen=True)
class Image:
    """A depth image (h, w) in m, 0 or NaN where unknown, taken at `stamp` (Unix time, s); one all around has its seam."""

    stamp: float
    depth: Depth


class CameraSource:
    """One camera or LiDAR, and how its images are doing. Raises InvalidRequest for a link that the robot has not, and intrinsics that
    are missing or see more than there is.
    """

    def __init__(self, camera: Camera, model: RobotModel) -> None:
        self.camera = camera
        link = camera.link or model.robot.descriptor.base_link
        try:
            self._joint, mounted = model.mount(link)
        except (InvalidRequest, KeyError) as error:
            raise InvalidRequest(f"the robot has no link {link}; name one of its URDF", field="add.link") from error
        self._model, self._pose = model, mounted @ matrix(camera.position, camera.orientation)
        self._view = _view(camera)
        if self._view is not None and camera.projection == "spherical":
            self._pose = self._pose @ _OPTICAL
        self._images, self._seen_at, self._stamp = 0, clock.monotonic(), 0.0
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
        self._check(header.stamp)
        size, _ = self._known()
        if (header.width, header.height) != (size.width, size.height):
            raise InvalidRequest(
                f"an image of {header.width} x {header.height} pixels, where the camera {self.camera.name} has {size.width} x "
                f"{size.height}; declare it as it is",
                field="width",
            )
        kind = "<u2" if header.encoding == "16UC1" else "<f4"
        raw = np.frombuffer(pixels, kind).reshape(header.height, header.width)
        depth = raw.astype(np.float32) * np.float32(0.001) if kind == "<u2" else raw.astype(np.float32)
        return self._newest(header.stamp, depth)

    def read_cloud(self, payload: bytes) -> Image | None:
        """The image of the points in a payload, as `read` has it."""
        header, data = decode_cloud(payload)
        self._check(header.stamp)
        size, view = self._known()
        points = np.frombuffer(data, "<f4").reshape(-1, 3)
        if view.spherical:
            points = points @ _OPTICAL[:3, :3].astype(np.float32)
        depth = np.empty((size.height, size.width), np.float32)
        project(np.ascontiguousarray(points), view._replace(cx=size.cx, seam=0), depth)
        return self._newest(header.stamp, depth)

    def _newest(self, stamp: float, depth: Depth) -> Image | None:
        if stamp <= self._stamp or self._view is None:
            return None
        self._stamp = stamp
        if seam := self._view.seam:
            depth = np.concatenate((depth[:, -seam:], depth, depth[:, :seam]), axis=1)
        return Image(stamp, depth)

    def _check(self, stamp: float) -> None:
        """Raises InvalidRequest for an image that was taken at another time."""
        late = clock.unix_time() - stamp
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

    def _known(self) -> tuple[Intrinsics, View]:
        """Its intrinsics, and how it sees with them. Raises InvalidRequest where they are not known."""
        size = self.camera.intrinsics
        if size is None or self._view is None:
            raise InvalidRequest(
                f"the intrinsics of the camera {self.camera.name} are not known; declare width, height, fx, fy, cx and cy",
                field="width",
            )
        return size, self._view

    def view(self, joints: Array) -> View:
        """Where the camera is with the robot at joints (dof,)."""
        pose = self._pose
        if self.moves:
            pose = self._model.fk_joint(self._joint, joints) @ pose
        return self._known()[1]._replace(
            turn=np.ascontiguousarray(pose[:3, :3]), place=np.ascontiguousarray(pose[:3, 3])
        )

    def taken(self, valid: float, robot: float, took: float) -> None:
        """An image was taken into the map: the shares of its pixels with a depth and of the robot, and how long that took (s)."""
        self._images += 1
        self._arrived = True
        if valid >= COVERED:
            self._seen_at = clock.monotonic()
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
        return clock.monotonic() - self._seen_at

    @property
    def stale(self) -> bool:
        """Whether it has not seen for a while; a single image that cannot be used does not matter."""
        return self._age > max(SILENCE, 5.0 / self.camera.rate)

    @property
    def state(self) -> CameraState:
        """How its images are doing now."""
        age, problem = self._age, self._fault
        if self._view is None:
            problem = "its intrinsics are not known: no camera_info came"
        elif self.stale and not problem:
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


def _view(camera: Camera) -> View | None:
    """How a camera sees, its frame at the origin; None while its intrinsics are not known. Raises InvalidRequest."""
    size = camera.intrinsics
    if size is None:
        given = camera.model_fields_set & {*Intrinsics._fields}
        if camera.topic is None or given or camera.topic_type != "sensor_msgs/msg/Image":
            missing = ", ".join(name for name in Intrinsics._fields if getattr(camera, name) is None)
            raise InvalidRequest(
                f"the intrinsics are not complete: {missing} missing; only where a ROS topic sends images they may be left out, all of "
                "them",
                field="add",
            )
        return None
    spherical, seam = camera.projection == "spherical", 0
    if spherical:
        turn, tilt = size.width / size.fx, size.height / size.fy
        if turn > 2.0 * np.pi + 1.5 / size.fx or tilt > np.pi + 1.5 / size.fy:
            raise InvalidRequest(
                f"it would see {np.degrees(turn):.0f} by {np.degrees(tilt):.0f} deg, and there are 360 by 180; fx and fy are pixels in a "
                "radian",
                field="add.fx",
            )
        if turn > 2.0 * np.pi - 0.5 / size.fx:
            seam = int(_SEAM * size.fx)
    return View(
        size.fx, size.fy, size.cx + seam, size.cy, np.eye(3), np.zeros(3), camera.near, camera.far, spherical, seam
    )
