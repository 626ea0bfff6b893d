"""What cameras see: the cameras, their images, and the voxel map that is made of them."""

from __future__ import annotations

from base64 import b64decode
from typing import Annotated, Literal, NamedTuple

from pydantic import AfterValidator, Field

from zarm_contract._model import Message, ShortMessage
from zarm_contract.messages.motion import NonNegative, Positive, Quaternion, Vector3

MAX_CAMERAS = 16
BLOCK = 16
"""Voxels along each edge of a block."""
_BYTES = BLOCK**3 // 8

MAX_POINTS = 2_000_000
"""Points of a cloud."""

VoxelCount = Annotated[int, Field(ge=1, le=4096)]
Projection = Literal["pinhole", "spherical"]
TopicType = Literal["sensor_msgs/msg/Image", "sensor_msgs/msg/PointCloud2", "sensor_msgs/msg/LaserScan"]
Pixels = Annotated[int, Field(ge=16, le=8192)]
CameraName = Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]{0,63}$")]


class Intrinsics(NamedTuple):
    """The images of a camera: pixels in a row, rows, focal lengths and principal point (pixels), free of distortion."""

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float


class Camera(ShortMessage):
    """A depth camera or a LiDAR. Its frame is at `position` (m) and `orientation` in the frame of a `link` that the joints move or not, by
    default the base.

    With the projection `pinhole` the frame is optical: z forward, x right, y down. Images are `width` by `height` pixels, with focal lengths `fx`, `fy` and
    the principal point `cx`, `cy` in pixels, free of distortion. With `spherical`, as of a LiDAR, x is forward, y left and z up; columns are azimuths
    from left to right, rows elevations from top to bottom, `fx` and `fy` pixels in a radian, and `cx`, `cy` the pixel that looks forward.

    Depths below `near` or beyond `far` (m) do not count; `rate` is how many images come in a second. From a `topic` of ROS, of the type `topic_type`, the bridge takes them;
    where it sends images and the intrinsics are left out, these are taken from the `camera_info` beside it. Colour images come from a `color_topic`.
    """

    name: CameraName
    link: str | None = None
    position: Vector3
    orientation: Quaternion = (0.0, 0.0, 0.0, 1.0)
    projection: Projection = "pinhole"
    width: Pixels | None = None
    height: Pixels | None = None
    fx: Positive | None = None
    fy: Positive | None = None
    cx: float | None = None
    cy: float | None = None
    near: Positive = 0.15
    far: Positive = 4.0
    rate: Annotated[float, Field(gt=0, le=60)] = 10.0
    topic: Annotated[str, Field(min_length=1, max_length=255)] | None = None
    topic_type: TopicType = "sensor_msgs/msg/Image"
    color_topic: Annotated[str, Field(min_length=1, max_length=255)] | None = None

    @property
    def intrinsics(self) -> Intrinsics | None:
        """The intrinsics, None if one is left out."""
        if (
            self.width is None
            or self.height is None
            or self.fx is None
            or self.fy is None
            or self.cx is None
            or self.cy is None
        ):
            return None
        return Intrinsics(self.width, self.height, self.fx, self.fy, self.cx, self.cy)


class Cameras(Message):
    """The cameras of a robot."""

    cameras: tuple[Camera, ...] = Field(default=(), max_length=MAX_CAMERAS)


class CameraChange(Message):
    """Add a camera, or replace the one with its name, or remove one. An empty request only reads."""

    add: Camera | None = None
    remove: CameraName | None = None


class ImageHeader(ShortMessage):
    """The first line of a depth image; the pixels follow, row by row, in little-endian: z of each point in the camera's frame, or, of a `spherical` one, its range.

    With the encoding `16UC1` a pixel is a 16-bit integer in mm, with `32FC1` a 32-bit float in m, both as in ROS; 0 and NaN are unknown.
    The image was taken at `stamp` (Unix time, s).
    """

    stamp: float
    width: Pixels
    height: Pixels
    encoding: Literal["16UC1", "32FC1"]


class ColorHeader(ShortMessage):
    """The first line of a colour image; the pixels follow, row by row: a byte of grey with the encoding `mono8`, of red, green and blue each with `rgb8`, as in ROS.

    The image is registered to the depth: it has the frame and the intrinsics of the camera, as the left infrared image of a stereo camera has. It was taken at `stamp` (Unix
    time, s).
    """

    stamp: float
    width: Annotated[int, Field(ge=1, le=8192)]
    height: Annotated[int, Field(ge=1, le=8192)]
    encoding: Literal["mono8", "rgb8"]


class CloudHeader(ShortMessage):
    """The first line of a cloud of points; the `points` follow: x, y, z in the frame of the camera (m), each a 32-bit float in little-endian.

    The cloud was taken at `stamp` (Unix time, s).
    """

    stamp: float
    points: Annotated[int, Field(ge=0, le=MAX_POINTS)]


def _block(packed: str) -> str:
    try:
        found = b64decode(packed, validate=True)
    except ValueError as error:
        raise ValueError("not base64") from error
    if len(found) not in (0, _BYTES):
        raise ValueError(f"{len(found)} bytes where a block has {_BYTES}, or none if it is free")
    return packed


class VoxelBlock(ShortMessage):
    """A block of 16 x 16 x 16 voxels of the map, `resolution` (m) wide; the first is centred at `position` (m, base frame).

    `cells` has one bit for each voxel, base64, the highest bit of a byte first: bit `(i * 16 + j) * 16 + k` says whether voxel `(i, j, k)` is
    occupied. It is empty if none is.
    """

    position: Vector3
    resolution: Positive
    cells: Annotated[str, AfterValidator(_block)] = ""


class SavedMap(Message):
    """A voxel map of `shape` voxels, `resolution` (m) wide, from `lower` (m, base frame) on, as it is saved and loaded.

    `states` has a byte for each voxel, the last index first to change: 0 nobody has seen it, 1 free, 2 occupied; compressed by zlib, in base64.
    """

    lower: Vector3
    resolution: Positive
    shape: tuple[VoxelCount, VoxelCount, VoxelCount]
    states: str


class LoadedMap(ShortMessage):
    """How many `occupied` voxels a map had that was loaded, and how many of these lie `outside` the box of the map and are left out."""

    occupied: Annotated[int, Field(ge=0)]
    outside: Annotated[int, Field(ge=0)]


class CameraState(ShortMessage):
    """A camera: how many `images` came, the age of the last one (s), left out if none came, and how long the map took for it (s).

    `valid` is the share of its pixels with a depth, `robot` the share that is the robot itself. `problem` says what is wrong now, or is empty.
    """

    name: CameraName
    images: Annotated[int, Field(ge=0)] = 0
    age: NonNegative | None = None
    took: NonNegative = 0.0
    valid: Annotated[float, Field(ge=0, le=1)] = 0.0
    robot: Annotated[float, Field(ge=0, le=1)] = 0.0
    problem: str = ""


class PerceptionState(Message):
    """The voxel map from `lower` to `upper` (m, base frame), and its cameras. It is `stale` if a camera does not see any more: what it has seen stays."""

    cameras: tuple[CameraState, ...] = Field(default=(), max_length=MAX_CAMERAS)
    lower: Vector3
    upper: Vector3
    resolution: Positive
    padding: NonNegative
    unseen: Literal["free", "occupied"] = "free"
    occupied: Annotated[int, Field(ge=0)] = 0
    stale: bool = False
    stamp: float
