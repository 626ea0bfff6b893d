"""`zarm record`: what passes on the bus, written to a file as it comes."""

from __future__ import annotations

import math
import queue
import threading
import time
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from zarm_cli.client import Connect, Name, connected
from zarm_cli.interrupts import Inbox, wait_for
from zarm_cli.output import counted, err, out
from zarm_contract.errors import InvalidRequest, Unavailable
from zarm_contract.keys import Keys
from zarm_runtime.recorded import Recorded
from zarm_runtime.session import DEFAULT_ENDPOINT

if TYPE_CHECKING:
    from zarm_runtime.record import Entry, RecordFile

_BACKLOG = 100_000
"""Messages that may wait for a disk that is slow; more are lost, and counted. Minutes of a robot, some 50 MB."""

_FLUSH_SECONDS = 1.0
"""How much is lost at most when the command is killed, and how late a full disk is noticed."""


def record(
    file: Annotated[Path | None, typer.Argument(help="Left out: <robot>_<time in UTC>.mcap, here.")] = None,
    seconds: Annotated[float | None, typer.Option(min=0, help="How long; left out: until Ctrl-C.")] = None,
    connect: Connect = DEFAULT_ENDPOINT,
    name: Name = None,
) -> None:
    """Write what happens to the robot to an MCAP file, until Ctrl-C. Foxglove and `zarm replay` open it."""
    with connected(connect, name) as client:
        path = file or Path(f"{client.keys.robot}_{datetime.now(UTC):%Y%m%dT%H%M%S}Z.mcap")
        recorder = _Recorder(path, client.keys)
        try:
            recorded = Recorded(client.keys)
            for key in recorded.models:
                listen = client.bus.follow if key in recorded.present else client.bus.listen
                listen(key, recorder.put)
            err.print(f"recording {client.keys.robot} to {path}; Ctrl-C ends it", soft_wrap=True)
            wait_for(recorder.failed, math.inf if seconds is None else seconds)
        except KeyboardInterrupt:
            pass  # the usual end
        finally:
            recorder.close()
    lost = f", {recorder.lost} lost" if recorder.lost else ""
    out.print(f"{counted(recorder.count, 'message')} in {path}{lost}", soft_wrap=True)


class _Recorder:
    """Writes by a thread of its own what `put` is given, by any thread; `failed` gets why when that goes wrong."""

    def __init__(self, path: Path, keys: Keys) -> None:
        if path.exists():
            raise InvalidRequest(f"{path} is there already; name another file, or remove it", field="file")
        self.failed: Inbox[OSError] = Inbox()
        self.lost = 0
        self._error: OSError | None = None
        self._entries: queue.SimpleQueue[Entry | None] = queue.SimpleQueue()
        self._path = path
        self._file = _open(path, keys)
        self._thread = threading.Thread(target=self._write, name="record")
        self._thread.start()

    @property
    def count(self) -> int:
        return self._file.count

    def put(self, key: str, payload: bytes) -> None:
        if self._entries.qsize() < _BACKLOG:
            self._entries.put((time.time_ns(), key, payload))
        else:
            self.lost += 1

    def close(self) -> None:
        """Write what is left and finish the file. Raises Unavailable where that failed."""
        self._entries.put(None)
        self._thread.join()
        if self._error is not None:
            raise _unwritable(self._path, self._error, f"; what came before is in {self._file.draft}")

    def _write(self) -> None:
        try:
            flushed = time.monotonic()
            while (entry := self._entries.get()) is not None:
                self._file.write(entry)
                if time.monotonic() - flushed > _FLUSH_SECONDS:
                    self._file.flush()
                    flushed = time.monotonic()
            self._file.close()
        except OSError as error:
            self._error = error
            self._file.abandon()
            self.failed.put(error)


def _open(path: Path, keys: Keys) -> RecordFile:
    from zarm_runtime.record import RecordFile  # no other command needs the libraries behind it

    try:
        return RecordFile(path, keys)
    except OSError as error:
        raise _unwritable(path, error) from error


def _unwritable(path: Path, error: OSError, rest: str = "") -> Unavailable:
    return Unavailable(f"cannot write {path}: {error.strerror or error}{rest}; make room, or name another file")
