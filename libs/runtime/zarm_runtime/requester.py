"""The client whose request is being answered."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

import zenoh

from zarm_contract.codec import decode
from zarm_contract.errors import InvalidRequest
from zarm_contract.messages import Requester

ANYONE = Requester.model_construct(client="", timeout=math.inf)
"""All requesters that do not identify themselves: any Zenoh client, and calls within one process."""

_requester: ContextVar[Requester] = ContextVar("requester", default=ANYONE)


def requester() -> Requester:
    """The requester for whom this thread works."""
    return _requester.get()


@contextmanager
def on_behalf_of(who: Requester) -> Iterator[None]:
    """Make `requester` return `who` in this thread."""
    before = _requester.set(who)
    try:
        yield
    finally:
        _requester.reset(before)


def requester_of(query: zenoh.Query) -> Requester:
    """The sender of a query; ANYONE if its attachment does not say."""
    if query.attachment is None:
        return ANYONE
    try:
        return decode(Requester, query.attachment.to_bytes())
    except InvalidRequest:  # other Zenoh tools attach anything
        return ANYONE
