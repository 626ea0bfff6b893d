"""The common base of the sections of a robot descriptor, and of other files that are written by hand."""

from __future__ import annotations

from pathlib import Path
from typing import TypeVar

from pydantic import BaseModel, ConfigDict, ValidationError

from zarm_contract._faults import sentence
from zarm_contract.document import Document, read_document
from zarm_contract.errors import InvalidRequest

S = TypeVar("S", bound="Section")


class Section(BaseModel):
    """Part of a file that is written by hand."""

    # Not strict: to YAML `1` is no float and `[...]` no tuple.
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


def read_section(path: Path, what: str, model: type[S]) -> tuple[Document, S]:
    """A file that is one section; `what` says what it is. Raises InvalidRequest with file and line, one line per fault."""
    document = read_document(path, what)
    try:
        return document, model.model_validate(document.data)
    except ValidationError as error:
        raise InvalidRequest(
            "\n".join(document.fault(tuple(one["loc"]), sentence(one["msg"])) for one in error.errors())
        ) from error
