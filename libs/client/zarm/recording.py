"""Messages on the bus, written to a file as they come."""

from __future__ import annotations

import math
import queue
import threading
import time
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Self

from zarm.connection import Connection
from zarm.interrupts import SLICE
from zarm_contract.errors import InvalidRequest, Unavailable
from zarm_runtime.recorded import Recorded

if TYPE_CHECKING:
    from zarm_runtime.record import Entry, RecordFile

_BACKLOG = 100_000
"""Messages that may wait for a slow disk; more are lost, and counted. Some minutes of a robot, about 50 MB."""

_IMAGES = 64
"""Images that may wait: 40 MB of depth, 60 MB of colour with 640 x 480 pixels."""

_FLUSH_SECONDS = 1.0
"""Seconds of messages lost at most when the program is killed, and the delay until a full disk is noticed."""


class Recorder:
    """Records the robot's messages to an MCAP file, `path`, until `close`; `Robot.record` makes it.

    Until then the file is `<path>.part`. Use it in `with`. Thread-safe. With `scene`, the scene, the voxel map and a simulation are in it
    too, and with `images` the depth and colour images of the cameras.
    """

    def __init__(self, connection: Connection, path: Path, *, scene: bool = False, images: bool = False) -> None:
        if path.exists():
            raise InvalidRequest(f"{path} already exists; name another file, or remove it", field="file")
        self.path = path
        self.lost = 0
        """Number of messages lost because the disk was too slow."""
        self._interrupts = connection.interrupts
        self._error: OSError | None = None
        self._entries: queue.SimpleQueue[Entry | None] = queue.SimpleQueue()
        cameras = (connection.keys.depth("*"), connection.keys.color("*"))
        self._cameras = tuple(key.removesuffix("*") for key in cameras)
        self._images = 0  # that wait
        self._counting = threading.Lock()
        self._file = self._open(connection)
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._write, name="record")
        self._thread.start()
        self._listening: list[Callable[[], None]] = []
        try:
            for key in Recorded(connection.keys, scene=scene).keys.values():
                before = key.rights.latched and key.recorded != "changes"
                listen = connection.bus.follow if before else connection.bus.listen
                self._listening.append(listen(key, self._put))
            if images:
                self._listening += [connection.bus.listen(key, self._put_image) for key in cameras]
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    @property
    def count(self) -> int:
        """The number of messages written."""
        return self._file.count

    def wait(self, seconds: float = math.inf) -> None:
        """Wait this long, or less if the disk fails, as in `close`."""
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0 and not self._ended.wait(min(left, SLICE)):
            self._interrupts.check()

    def close(self) -> None:
        """Write the remaining messages and finish the file. Raises Unavailable if that fails. Idempotent."""
        while self._listening:
            self._listening.pop()()
        self._entries.put(None)
        self._thread.join()
        if self._error is not None:
            raise _unwritable(self.path, self._error, f"; what came before is in {self._file.draft}")

    def _put(self, key: str, payload: bytes) -> None:
        if self._entries.qsize() < _BACKLOG:
            self._entries.put((time.time_ns(), key, payload))
        else:
            self.lost += 1

    def _put_image(self, key: str, payload: bytes) -> None:
        with self._counting:
            if self._images >= _IMAGES:
                self.lost += 1
                return
            self._images += 1
        self._put(key, payload)

    def _write(self) -> None:
        try:
            flushed = time.monotonic()
            while (entry := self._entries.get()) is not None:
                if entry[1].startswith(self._cameras):
                    self._write_image(entry)
                else:
                    self._file.write(entry)
                if time.monotonic() - flushed > _FLUSH_SECONDS:
                    self._file.flush()
                    flushed = time.monotonic()
            self._file.close()
        except OSError as error:
            self._error = error
            self._file.abandon()
        finally:
            self._ended.set()

    def _write_image(self, entry: Entry) -> None:
        with self._counting:
            self._images -= 1
        try:
            self._file.write_image(entry)
        except InvalidRequest:  # the perception says what is wrong with it
            self.lost += 1

    def _open(self, connection: Connection) -> RecordFile:
        from zarm_runtime.record import RecordFile  # nothing else needs these libraries

        try:
            return RecordFile(self.path, connection.keys)
        except OSError as error:
            raise _unwritable(self.path, error) from error


def _unwritable(path: Path, error: OSError, rest: str = "") -> Unavailable:
    return Unavailable(f"cannot write {path}: {error.strerror or error}{rest}; make room, or name another file")
