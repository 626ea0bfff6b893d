"""Depth images in records, as Foxglove shows them: `foxglove.RawImage` in JSON (https://docs.foxglove.dev/docs/sdk/schemas/raw-image)."""

from __future__ import annotations

import json
from base64 import b64encode

from zarm_contract.image import PIXEL_BYTES, decode_image

SCHEMA = "foxglove.RawImage"
_WHOLE = {"type": "integer", "minimum": 0}
DEFINITION = json.dumps(
    {
        "type": "object",
        "title": SCHEMA,
        "properties": {
            "timestamp": {"type": "object", "properties": {"sec": _WHOLE, "nsec": _WHOLE}},
            "frame_id": {"type": "string"},
            "width": _WHOLE,
            "height": _WHOLE,
            "encoding": {"type": "string"},
            "step": _WHOLE,
            "data": {"type": "string", "contentEncoding": "base64"},
        },
    }
).encode()


def raw_image(camera: str, payload: bytes) -> bytes:
    """A depth image of a camera on the bus as a RawImage; its frame has the name of the camera. Raises InvalidRequest for a payload that is no image."""
    header, pixels = decode_image(payload)
    seconds, fraction = divmod(header.stamp, 1.0)
    message = {
        "timestamp": {"sec": int(seconds), "nsec": int(fraction * 1e9)},
        "frame_id": camera,
        "width": header.width,
        "height": header.height,
        "encoding": header.encoding,
        "step": header.width * PIXEL_BYTES[header.encoding],
    }
    return json.dumps(message)[:-1].encode() + b', "data": "' + b64encode(pixels) + b'"}'
