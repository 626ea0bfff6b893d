"""What cameras see: the cameras, their images, and the voxel map that is made of them."""

from __future__ import annotations

from base64 import b64decode
from typing import Annotated, Literal

from pydantic import AfterValidator, Field

from zarm_contract._model import Message, ShortMessage
from zarm_contract.messages.motion import NonNegative, Positive, Quaternion, Vector3

MAX_CAMERAS = 16
BLOCK = 16
"""Voxels along each edge of a block."""
_BYTES = BLOCK**3 // 8

Pixels = Annotated[int, Field(ge=16, le=8192)]
CameraName = Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]{0,63}$")]


class Camera(ShortMessage):
    """A depth camera. Its optical frame, z forward, x right, y down, is at `position` (m) and `orientation` in the frame of a `link` that
    the joints move or not, by default the base.

    Images are `width` by `height` pixels, with focal lengths `fx`, `fy` and the principal point `cx`, `cy` in pixels, free of distortion. Depths
    below `near` or beyond `far` (m) do not count; `rate` is how many images come in a second. From a `topic` of ROS, of type `sensor_msgs/msg/Image`, the bridge takes them.
    """

    name: CameraName
    link: str | None = None
    position: Vector3
    orientation: Quaternion = (0.0, 0.0, 0.0, 1.0)
    width: Pixels
    height: Pixels
    fx: Positive
    fy: Positive
    cx: float
    cy: float
    near: Positive = 0.15
    far: Positive = 4.0
    rate: Annotated[float, Field(gt=0, le=60)] = 10.0
    topic: Annotated[str, Field(min_length=1, max_length=255)] | None = None


class Cameras(Message):
    """The cameras of a robot."""

    cameras: tuple[Camera, ...] = Field(default=(), max_length=MAX_CAMERAS)


class CameraChange(Message):
    """Add a camera, or replace the one with its name, or remove one. An empty request only reads."""

    add: Camera | None = None
    remove: CameraName | None = None


class ImageHeader(ShortMessage):
    """The first line of a depth image; the pixels follow, row by row, in little-endian: z of each point in the camera's frame.

    With the encoding `16UC1` a pixel is a 16-bit integer in mm, with `32FC1` a 32-bit float in m, both as in ROS; 0 and NaN are unknown.
    The image was taken at `stamp` (Unix time, s).
    """

    stamp: float
    width: Pixels
    height: Pixels
    encoding: Literal["16UC1", "32FC1"]


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
