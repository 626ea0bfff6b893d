"""Images on the bus: a header in JSON, the end of the line, and the pixels."""

from __future__ import annotations

from collections.abc import Mapping

from zarm_contract.codec import decode, encode
from zarm_contract.errors import InvalidRequest
from zarm_contract.messages import ImageHeader

PIXEL_BYTES: Mapping[str, int] = {"16UC1": 2, "32FC1": 4}
"""Bytes of a pixel in each encoding."""
_MOST = 1024
"""Longest header, in bytes."""


def encode_image(header: ImageHeader, pixels: bytes) -> bytes:
    """An image from its pixels, row by row in little-endian."""
    return encode(header) + b"\n" + pixels


def decode_image(payload: bytes) -> tuple[ImageHeader, memoryview]:
    """Header and pixels of an image. Raises InvalidRequest if these are not as many as the header says."""
    end = payload.find(b"\n", 0, _MOST)
    if end < 0:
        raise InvalidRequest("an image begins with its header, a line of JSON; the pixels follow", field="payload")
    header = decode(ImageHeader, payload[:end])
    pixels = memoryview(payload)[end + 1 :]
    expected = header.width * header.height * PIXEL_BYTES[header.encoding]
    if len(pixels) != expected:
        raise InvalidRequest(
            f"{len(pixels)} bytes of pixels, where {header.width} x {header.height} of {header.encoding} take {expected}",
            field="payload",
        )
    return header, pixels
