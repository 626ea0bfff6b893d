"""Saved state: one message per file, with a version, in a folder that has one owner.

A file is `{"version": 1, "written_by": "<version of zarm>", "content": <the message>}`. What was written before files stated a
version is of version 0, and the whole of it is its content. No file is ever lost: whatever takes the place of one that was of
an older version, or could not be read, leaves it beside its own (`scene.json.v0`, `scene.json.broken`).
"""

from __future__ import annotations

import fcntl
import json
import logging
import os
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, Generic, TypeVar

from zarm_contract.codec import decode, encode
from zarm_contract.errors import InvalidRequest, Unavailable
from zarm_contract.messages import Message
from zarm_runtime.version import version

log = logging.getLogger(__name__)

M = TypeVar("M", bound=Message)

Migration = Callable[[Any], Any]
"""From the content of one version, as JSON reads it, to that of the next. Raises what `_UNREADABLE` lists."""

_UNREADABLE = (InvalidRequest, ValueError, LookupError, TypeError, AttributeError, RecursionError)
"""What reading and migrating raise for a file that was cut short or changed."""

_REMEDY = "make room or make the folder writable, or name another with --state or ZARM_STATE"


def unchanged(content: Any) -> Any:
    """The migration of a content that has stayed the same."""
    return content


class StateFile(Generic[M]):
    """A message of class `model` at `path`, replaced whole or not at all. Safe for any number of threads.

    `migrations[n]` leads from version n to n + 1, so that their number is the version that is written. It outlives a crash of
    the process; only where it is `flushed` to the disk, which takes milliseconds, it outlives a power cut too.
    """

    def __init__(
        self, path: Path, model: type[M], *, migrations: Sequence[Migration] = (unchanged,), flushed: bool = False
    ) -> None:
        self.path = path
        self._model = model
        self._migrations = migrations
        self._flushed = flushed
        self._saving = threading.Lock()  # two at once would take each other's draft away

    def load(self) -> M | None:
        """The message; None if there is none, or if the file could not be read and was moved aside.

        Raises Unavailable if a newer zarm wrote it or the folder cannot be used; then nothing has changed.
        """
        try:
            payload = self.path.read_bytes()
            try:
                message, version = self._read(payload)
            except _UNREADABLE as error:
                aside = self._aside("broken")
                self.path.replace(aside)
                log.error("a state file cannot be read path=%s kept=%s reason=%s", self.path, aside, error)
                return None
            if version < len(self._migrations):
                aside = self._aside(f"v{version}")
                self._replace(aside, payload)
                self.save(message)
                log.info(
                    "migrated a state file path=%s from=%d to=%d kept=%s",
                    self.path,
                    version,
                    len(self._migrations),
                    aside,
                )
        except FileNotFoundError:
            return None
        except OSError as error:
            raise Unavailable(f"cannot read {self.path}: {error.strerror or error}; {_REMEDY}") from error
        return message

    @property
    def broken(self) -> Path | None:
        """Where the content lies that could not be read, until another is saved; None if nothing is missing."""
        found = sorted(self.path.parent.glob(f"{self.path.name}.broken*"), key=lambda file: file.stat().st_mtime)
        return found[-1] if found and not self.path.exists() else None

    def save(self, message: M) -> None:
        """Replace the message. Raises Unavailable if the file cannot be written; then the old one is there as before."""
        self.write(encode(message))

    def write(self, content: bytes) -> None:
        """`save` of a message that is encoded already."""
        head = json.dumps({"version": len(self._migrations), "written_by": version()})
        try:
            self._replace(self.path, head[:-1].encode() + b', "content": ' + content + b"}")
        except OSError as error:
            raise Unavailable(f"cannot write {self.path}: {error.strerror or error}; {_REMEDY}") from error

    def clear(self) -> None:
        """Remove the message; where that fails a warning is logged."""
        try:
            self.path.unlink(missing_ok=True)
        except OSError as error:
            log.warning("cannot remove a state file path=%s reason=%s", self.path, error)

    def _read(self, payload: bytes) -> tuple[M, int]:
        document = json.loads(payload)
        version = document.get("version", 0)
        if version > len(self._migrations):
            raise Unavailable(
                f"{self.path} has version {version}, written by zarm {document.get('written_by')}, and this zarm reads versions up "
                f"to {len(self._migrations)}; run that version of zarm, or move the file away to begin without it"
            )
        content = document["content"] if version > 0 else document
        for migration in self._migrations[version:]:
            content = migration(content)
        return decode(self._model, json.dumps(content).encode()), version

    def _aside(self, suffix: str) -> Path:
        """A name beside the file's own that is free."""
        aside, count = self.path.with_name(f"{self.path.name}.{suffix}"), 1
        while aside.exists():
            count += 1
            aside = self.path.with_name(f"{self.path.name}.{suffix}.{count}")
        return aside

    def _replace(self, path: Path, content: bytes) -> None:
        draft = path.with_name(path.name + ".new")
        with self._saving:
            try:
                path.parent.mkdir(parents=True, exist_ok=True)
                with draft.open("wb") as file:
                    file.write(content)
                    if self._flushed:
                        file.flush()
                        os.fsync(file.fileno())
                draft.replace(path)
            except OSError:
                with suppress(OSError):
                    draft.unlink(missing_ok=True)
                raise
            if self._flushed:
                folder = os.open(path.parent, os.O_RDONLY)
                try:
                    os.fsync(folder)
                finally:
                    os.close(folder)


@contextmanager
def owned(folder: Path, service: str) -> Iterator[Path]:
    """The folder, which is made where it is missing, as one that no other process of this service uses meanwhile.

    Two on different buses would not see each other, and would take each other's files for their own. Raises Unavailable.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        file = (folder / f"{service}.lock").open("ab")
    except OSError as error:
        raise Unavailable(f"cannot save state in {folder}: {error.strerror or error}; {_REMEDY}") from error
    with file:  # its end, however the process comes to it, gives the lock back
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise Unavailable(
                f"another {service} keeps its state in {folder}; stop it, or give this one another --name, or another folder "
                "with --state or ZARM_STATE"
            ) from error
        except OSError as error:
            raise Unavailable(f"cannot lock {folder}: {error.strerror or error}; {_REMEDY}") from error
        yield folder
