"""Images and clouds on the bus: a header in JSON, the end of the line, and the pixels or points."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TypeVar

from zarm_contract.codec import decode, encode
from zarm_contract.errors import InvalidRequest
from zarm_contract.messages import CloudHeader, ColorHeader, ImageHeader

M = TypeVar("M", ImageHeader, ColorHeader, CloudHeader)

PIXEL_BYTES: Mapping[str, int] = {"16UC1": 2, "32FC1": 4}
"""Bytes of a pixel in each encoding of depth."""
COLOR_BYTES: Mapping[str, int] = {"mono8": 1, "rgb8": 3}
"""Bytes of a pixel in each encoding of colour."""
COUNTS, OF_ROBOT = 255, 128
"""What a pixel of a mask is: one that counts for the map, and one of the robot, which is left out; 0 is one without a depth, or noise."""
_MASK_COLUMNS = 160
POINT_BYTES = 12
"""Bytes of a point: x, y, z."""
_MAX_HEADER_BYTES = 1024
"""Longest header, in bytes."""


def mask_step(width: int) -> int:
    """A mask has every so many pixels, in a row and in a column, of an image of this width."""
    return -(-width // _MASK_COLUMNS)


def encode_image(header: ImageHeader | ColorHeader | CloudHeader, data: bytes) -> bytes:
    """An image from its pixels, row by row, or a cloud from its points, in little-endian."""
    return encode(header) + b"\n" + data


def decode_image(payload: bytes) -> tuple[ImageHeader, memoryview]:
    """Header and pixels of a depth image. Raises InvalidRequest if these are not as many as the header says."""
    header, pixels = _split(payload, ImageHeader, "an image", "pixels")
    _check_count(header, pixels, PIXEL_BYTES)
    return header, pixels


def decode_color(payload: bytes) -> tuple[ColorHeader, memoryview]:
    """Header and pixels of a colour image. Raises InvalidRequest if these are not as many as the header says."""
    header, pixels = _split(payload, ColorHeader, "an image", "pixels")
    _check_count(header, pixels, COLOR_BYTES)
    return header, pixels


def decode_cloud(payload: bytes) -> tuple[CloudHeader, memoryview]:
    """Header and points of a cloud. Raises InvalidRequest if these are not as many as the header says."""
    header, points = _split(payload, CloudHeader, "a cloud", "points")
    if len(points) != header.points * POINT_BYTES:
        raise InvalidRequest(
            f"{len(points)} bytes of points, where {header.points} of them take {header.points * POINT_BYTES}",
            field="payload",
        )
    return header, points


def _check_count(header: ImageHeader | ColorHeader, pixels: memoryview, sizes: Mapping[str, int]) -> None:
    expected = header.width * header.height * sizes[header.encoding]
    if len(pixels) != expected:
        raise InvalidRequest(
            f"{len(pixels)} bytes of pixels, where {header.width} x {header.height} of {header.encoding} take {expected}",
            field="payload",
        )


def _split(payload: bytes, model: type[M], what: str, follow: str) -> tuple[M, memoryview]:
    end = payload.find(b"\n", 0, _MAX_HEADER_BYTES)
    if end < 0:
        raise InvalidRequest(f"{what} begins with its header, a line of JSON; the {follow} follow", field="payload")
    return decode(model, payload[:end]), memoryview(payload)[end + 1 :]
