"""Saved state: one message per file, with a version, in a folder that has one owner.

A file is `{"version": 1, "written_by": "<version of zarm>", "content": <the message>}`. Files from before this format
have version 0 and consist of the content alone. No file is ever lost: when one of an older version, or an unreadable
one, is replaced, it is kept beside the new one (`scene.json.v0`, `scene.json.broken`).
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
"""From the content of one version, as parsed from JSON, to that of the next. Raises what `_UNREADABLE` lists."""

_UNREADABLE = (InvalidRequest, ValueError, LookupError, TypeError, AttributeError, RecursionError)
"""Errors raised in reading and migrating a truncated or modified file."""

_REMEDY = "make room or make the folder writable, or name another with --state or ZARM_STATE"


def unchanged(content: Any) -> Any:
    """The migration of unchanged content."""
    return content


class StateFile(Generic[M]):
    """A message of class `model` at `path`, replaced completely or not at all. Thread-safe.

    `migrations[n]` leads from version n to n + 1, so their number is the version written. The file survives a crash of
    the process; only if it is `flushed` to the disk, which takes milliseconds, it also survives a power cut.
    """

    def __init__(
        self, path: Path, model: type[M], *, migrations: Sequence[Migration] = (unchanged,), flushed: bool = False
    ) -> None:
        self.path = path
        self._model = model
        self._migrations = migrations
        self._flushed = flushed
        self._saving = threading.Lock()  # two at once would remove each other's drafts

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
        """Where the unreadable content is kept until another one is saved; None if nothing is missing."""
        found = sorted(self.path.parent.glob(f"{self.path.name}.broken*"), key=lambda file: file.stat().st_mtime)
        return found[-1] if found and not self.path.exists() else None

    def save(self, message: M) -> None:
        """Replace the message. Raises Unavailable if the file cannot be written; the old one then remains."""
        self.write(encode(message))

    def write(self, content: bytes) -> None:
        """`save` for an encoded message."""
        head = json.dumps({"version": len(self._migrations), "written_by": version()})
        try:
            self._replace(self.path, head[:-1].encode() + b', "content": ' + content + b"}")
        except OSError as error:
            raise Unavailable(f"cannot write {self.path}: {error.strerror or error}; {_REMEDY}") from error

    def clear(self) -> None:
        """Remove the message; a failure is logged as a warning."""
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
        """A free name beside the file's own."""
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
    """The folder, created if missing, which no other process of this service may use meanwhile.

    Two on different buses would not see each other, and would use each other's files. Raises Unavailable.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        file = (folder / f"{service}.lock").open("ab")
    except OSError as error:
        raise Unavailable(f"cannot save state in {folder}: {error.strerror or error}; {_REMEDY}") from error
    with file:  # the end of the process, however it comes, releases the lock
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
