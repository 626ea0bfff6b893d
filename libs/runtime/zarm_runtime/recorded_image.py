"""Images in records, as Foxglove shows them: `foxglove.RawImage` in JSON (https://docs.foxglove.dev/docs/sdk/schemas/raw-image)."""

from __future__ import annotations

import json
from base64 import b64decode, b64encode

from zarm_contract.errors import InvalidRequest
from zarm_contract.image import COLOR_BYTES, PIXEL_BYTES
from zarm_contract.messages import ColorHeader, ImageHeader

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


def raw_image(camera: str, header: ImageHeader | ColorHeader, pixels: memoryview) -> bytes:
    """An image of a camera on the bus as a RawImage; its frame has the name of the camera."""
    seconds, fraction = divmod(header.stamp, 1.0)
    message = {
        "timestamp": {"sec": int(seconds), "nsec": int(fraction * 1e9)},
        "frame_id": camera,
        "width": header.width,
        "height": header.height,
        "encoding": header.encoding,
        "step": header.width * {**PIXEL_BYTES, **COLOR_BYTES}[header.encoding],
    }
    return json.dumps(message)[:-1].encode() + b', "data": "' + b64encode(pixels) + b'"}'


def color_of(message: bytes) -> tuple[ColorHeader, bytes]:
    """Header and pixels of a colour image in a record. Raises InvalidRequest for a message that is none."""
    try:
        image = json.loads(message)
        taken = image["timestamp"]
        header = ColorHeader(
            stamp=taken["sec"] + taken["nsec"] * 1e-9,
            width=image["width"],
            height=image["height"],
            encoding=image["encoding"],
        )
        pixels = b64decode(image["data"])
    except (ValueError, TypeError, KeyError) as error:
        raise InvalidRequest(f"a colour image in the record is none of {SCHEMA}: {error}", field="file") from error
    if len(pixels) != header.width * header.height * COLOR_BYTES[header.encoding]:
        raise InvalidRequest(f"a colour image in the record has {len(pixels)} bytes of pixels", field="file")
    return header, pixels
