"""Records as MCAP files (https://mcap.dev), which Foxglove opens.

A channel is a key of the bus, a message the exact bytes sent over it (encoding `json`), with the schema of its class
(`jsonschema`, named `zarm.<Message>.v4`). `log_time` is when it was sent or received here, in ns since 1970;
`publish_time` is the same, except for values that already held when the record begins: then it is when they were
published. Images, which are there on request, are `foxglove.RawImage`.
"""

from __future__ import annotations

import functools
import json
import os
import struct
import zlib
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any, BinaryIO

from mcap.exceptions import McapError
from mcap.reader import make_reader
from mcap.writer import Writer
from zstandard import ZstdError

from zarm_contract.codec import CONTRACT, other_contract, schema
from zarm_contract.errors import InvalidRequest
from zarm_contract.image import decode_color, decode_image
from zarm_contract.keys import Keys
from zarm_contract.messages import Message
from zarm_runtime.recorded import Recorded
from zarm_runtime.recorded_image import DEFINITION, SCHEMA, raw_image
from zarm_runtime.version import version

Entry = tuple[int, str, bytes]
"""Time (ns since 1970), key, and payload. A plain tuple, because the garbage collector does not scan those."""

DRAFT = ".part"
"""Suffix of a record's name until it is complete."""


_DAMAGED = (McapError, ZstdError, ValueError, LookupError, OverflowError, MemoryError, struct.error)
"""Errors that the libraries raise for a truncated or modified file; lengths in it may have any value."""

_FOOTER_HEAD = 9
"""Bytes of opcode and length at the beginning of the footer of an MCAP file."""
_AFTER_SUMMARY = 12
"""Bytes after what the checksum of the summary is about: the checksum and the magic number."""
_FOOTER_END = _FOOTER_HEAD + 16 + _AFTER_SUMMARY
"""Bytes from the beginning of the footer to the end of the file."""


class RecordFile:
    """A record written to `<path>.part`, which appears as `path` when it is closed, complete or not at all.

    Any method raises OSError if it cannot be written. It is not flushed to the disk: a power cut may lose it.
    """

    def __init__(self, path: Path, keys: Keys) -> None:
        self.path = path
        self.draft = path.with_name(path.name + DRAFT)
        self.count = 0
        self._recorded = Recorded(keys, scene=True)
        self._color = keys.color("*").removesuffix("*")
        self._schemas: dict[type[Message], int] = {}
        self._channels: dict[str, int] = {}
        self._image_schema = 0
        path.parent.mkdir(parents=True, exist_ok=True)
        self._stream = self.draft.open("wb")
        self._writer = Writer(self._stream)
        self._writer.start(library=f"zarm {version()}")

    def write(self, entry: Entry, *, published: int | None = None) -> None:
        """Add one message. Raises ValueError for a key that is not recorded."""
        stamp, key, payload = entry
        channel = self._channels.get(key) or self._new_channel(key)
        self.count += 1
        self._writer.add_message(
            channel, log_time=stamp, data=payload, publish_time=published or stamp, sequence=self.count
        )

    def write_image(self, entry: Entry) -> None:
        """Add a depth or colour image. Raises InvalidRequest for a payload that is none."""
        stamp, key, payload = entry
        header, pixels = decode_color(payload) if key.startswith(self._color) else decode_image(payload)
        data = raw_image(key.rpartition("/")[2], header, pixels)
        if key not in self._channels:
            self._image_schema = self._image_schema or self._writer.register_schema(SCHEMA, "jsonschema", DEFINITION)
            self._channels[key] = self._writer.register_channel(key, "json", self._image_schema)
        self.count += 1
        self._writer.add_message(
            self._channels[key], log_time=stamp, data=data, publish_time=stamp, sequence=self.count
        )

    def flush(self) -> None:
        """Hand all data written so far to the system: if the process is killed, the draft contains that much."""
        self._writer.flush()

    def close(self) -> None:
        """Finish the file; from now on it is at `path`, replacing what was there."""
        self._writer.finish()
        self._stream.close()
        self.draft.replace(self.path)

    def abandon(self) -> None:
        """Stop writing, and leave the draft as it is."""
        with suppress(OSError):  # what could not be written before cannot be written now
            self._stream.close()

    def _new_channel(self, key: str) -> int:
        model = self._recorded.model(key)
        if model is None:
            raise ValueError(f"{key} is not recorded")
        if model not in self._schemas:
            self._schemas[model] = self._writer.register_schema(
                schema(model), "jsonschema", json.dumps(plain_schema(model)).encode()
            )
        self._channels[key] = self._writer.register_channel(key, "json", self._schemas[model])
        return self._channels[key]


def read_record(path: Path) -> Iterator[Entry]:
    """The messages of a record in the order of their `log_time`. Raises InvalidRequest if it cannot be read."""
    try:
        with path.open("rb") as stream:
            _check_summary(stream)
            for described, channel, message in make_reader(stream, validate_crcs=True).iter_messages():
                if described is not None and (other := other_contract(described.name)):
                    raise InvalidRequest(
                        f"{path} is a record of contract {other}, and this zarm reads {CONTRACT}; replay it with the zarm that "
                        "wrote it",
                        field="file",
                    )
                yield message.log_time, channel.topic, message.data
    except OSError as error:
        raise InvalidRequest(f"cannot read {path}: {error.strerror or error}", field="file") from error
    except _DAMAGED as error:
        raise InvalidRequest(
            f"{path} is not a whole MCAP file ({error or type(error).__name__}); `mcap recover` of mcap.dev saves what "
            "there is of one that was cut short",
            field="file",
        ) from error


def _check_summary(stream: BinaryIO) -> None:
    """Raises ValueError if the summary at the end of an MCAP file is not as it was written. The reader takes the keys of the messages from it, and
    checks the checksums of their chunks alone.

    The layout of the footer is that of https://mcap.dev/spec#footer-op0x02; a checksum of 0 means none.
    """
    end = stream.seek(0, os.SEEK_END)
    stream.seek(max(0, end - _FOOTER_END))
    begin, checksum = struct.unpack_from("<Q8xI", stream.read(), _FOOTER_HEAD)
    if checksum:
        stream.seek(begin)
        if zlib.crc32(stream.read(max(0, end - _AFTER_SUMMARY - begin))) != checksum:
            raise ValueError("its summary is damaged")
    stream.seek(0)


@functools.cache
def plain_schema(model: type[Message]) -> dict[str, Any]:
    """The JSON schema of a message class in the few keywords that Foxglove knows.

    Its reader (parseJsonSchema in foxglove/studio, packages/mcap-support) refuses a channel for a `$ref`, an `anyOf`,
    an array without `items`, or an array of arrays. So references are expanded, `X | None` becomes X, a tuple an array, and one of several
    objects an object with the fields of all; rows of numbers are not described, although they are in the messages.
    """
    whole = model.model_json_schema()
    return _plain(whole, whole.get("$defs", {}))


def _plain(node: dict[str, Any], definitions: dict[str, Any]) -> dict[str, Any]:
    if "$ref" in node:
        node = definitions[node["$ref"].rsplit("/", 1)[1]]
    if "anyOf" in node:
        return _plain(next(option for option in node["anyOf"] if option.get("type") != "null"), definitions)
    if "oneOf" in node:
        options = [_plain(option, definitions) for option in node["oneOf"]]
        fields = {name: field for option in options for name, field in option["properties"].items()}
        always = [name for name in fields if all(name in option["required"] for option in options)]
        return {"type": "object", "properties": fields, "required": always}
    plain: dict[str, Any] = {name: node[name] for name in ("type", "title", "description", "enum") if name in node}
    if node["type"] == "array":
        plain["items"] = _plain(node["items"] if "items" in node else node["prefixItems"][0], definitions)
    if node["type"] == "object":
        fields = {name: _plain(field, definitions) for name, field in node["properties"].items()}
        plain["properties"] = {name: field for name, field in fields.items() if not _rows(field)}
        plain["required"] = [name for name in node.get("required", ()) if name in plain["properties"]]
    return plain


def _rows(field: dict[str, Any]) -> bool:
    return bool(field["type"] == "array" and field["items"]["type"] == "array")
