"""One message in one file that outlives the process."""

from __future__ import annotations

import logging
import threading
from contextlib import suppress
from pathlib import Path
from typing import Generic, TypeVar

from zarm_contract.codec import decode, encode
from zarm_contract.errors import InvalidRequest, Unavailable
from zarm_contract.messages import Message

log = logging.getLogger(__name__)

M = TypeVar("M", bound=Message)


class StateFile(Generic[M]):
    """A message of class `model` as JSON at `path`, replaced whole or not at all.

    It outlives a crash of the process. It is not flushed to the disk, so a power cut may lose it.
    """

    def __init__(self, path: Path, model: type[M]) -> None:
        self._path = path
        self._model = model
        self._saving = threading.Lock()  # two at once would take each other's draft away

    def load(self) -> M | None:
        """The message, or None where there is none or what is there cannot be read (then a warning is logged)."""
        try:
            return decode(self._model, self._path.read_bytes())
        except FileNotFoundError:
            return None
        except (OSError, InvalidRequest) as error:
            log.warning("ignored a state file path=%s reason=%s", self._path, error)
            return None

    def save(self, message: M) -> None:
        """Replace the message. Raises Unavailable where the file cannot be written; then the old one is there as before."""
        draft = self._path.with_suffix(".new")
        with self._saving:
            try:
                self._path.parent.mkdir(parents=True, exist_ok=True)
                draft.write_bytes(encode(message))
                draft.replace(self._path)
            except OSError as error:
                with suppress(OSError):
                    draft.unlink(missing_ok=True)
                raise Unavailable(
                    f"cannot write {self._path}: {error.strerror or error}; make room or make the folder writable, or name "
                    "another with --state or ZARM_STATE"
                ) from error

    def clear(self) -> None:
        """Remove the message; where that fails a warning is logged."""
        try:
            self._path.unlink(missing_ok=True)
        except OSError as error:
            log.warning("cannot remove a state file path=%s reason=%s", self._path, error)
