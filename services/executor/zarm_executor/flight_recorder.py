"""Writes the last minute to a file when the executor enters a fault."""

from __future__ import annotations

import logging
import threading
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from types import TracebackType
from typing import Self

from zarm_contract.errors import Problem
from zarm_contract.keys import Keys
from zarm_executor.ring import Ring
from zarm_runtime.record import DRAFT, RecordFile

log = logging.getLogger(__name__)

KEPT = 20
"""Number of records kept; older ones are removed."""

_PATIENCE = 10.0
"""How long (s) the process waits at its end for a record to be written."""


class FlightRecorder:
    """Writes `<folder>/<time in UTC>_<code of the problem>.mcap` for each fault, in its own thread; use it in `with`.

    A fault during writing is recorded next. If several wait, only the last is recorded, because a record reaches back
    beyond the one before it. A record that cannot be written causes only a warning.
    """

    def __init__(self, folder: Path, keys: Keys, ring: Ring) -> None:
        self._folder = folder
        self._keys = keys
        self._ring = ring
        self._waiting: Problem | None = None
        self._ending = False
        self._changed = threading.Condition()
        self._thread = threading.Thread(target=self._run, name="fault records", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with self._changed:
            self._ending = True
            self._changed.notify_all()
        self._thread.join(_PATIENCE)

    def fault(self, problem: Problem) -> None:
        """Request the record of this fault; returns at once."""
        with self._changed:
            self._waiting = problem
            self._changed.notify_all()

    def _run(self) -> None:
        while (problem := self._next()) is not None:
            path = self._folder / f"{datetime.now(UTC):%Y%m%dT%H%M%S.%f}Z_{problem.code}.mcap"
            try:
                self._write(path)
            except OSError as error:
                log.warning(
                    "no record of the fault path=%s reason=%s remedy=make_room_or_name_another_folder_with_--state",
                    path,
                    error.strerror or error,
                )
            self._tidy()

    def _next(self) -> Problem | None:
        with self._changed:
            self._changed.wait_for(lambda: self._waiting is not None or self._ending)
            problem, self._waiting = self._waiting, None
            return problem

    def _write(self, path: Path) -> None:
        before, entries = self._ring.contents()
        file = RecordFile(path, self._keys)
        try:
            for stamp, key, payload in before:
                file.write((entries[0][0], key, payload), published=stamp)
            for entry in entries:
                file.write(entry)
            file.close()
        except OSError:
            file.abandon()
            with suppress(OSError):
                file.draft.unlink()
            raise
        log.info("record path=%s messages=%d", path, file.count)

    def _tidy(self) -> None:
        """Remove old records, and the drafts of processes killed while writing."""
        drafts = list(self._folder.glob(f"*.mcap{DRAFT}"))
        try:
            for old in (*drafts, *sorted(self._folder.glob("*.mcap"))[:-KEPT]):
                old.unlink()
        except OSError as error:
            log.warning("old records cannot be removed folder=%s reason=%s", self._folder, error.strerror or error)
