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
"""Whoever does not say who it is, all of them together: any Zenoh client, and calls within one process."""

_requester: ContextVar[Requester] = ContextVar("requester", default=ANYONE)


def requester() -> Requester:
    """Who asks for what this thread works on."""
    return _requester.get()


@contextmanager
def on_behalf_of(who: Requester) -> Iterator[None]:
    """Have `requester` return `who` in this thread."""
    before = _requester.set(who)
    try:
        yield
    finally:
        _requester.reset(before)


def requester_of(query: zenoh.Query) -> Requester:
    """Who sent a query; ANYONE where its attachment does not say so."""
    if query.attachment is None:
        return ANYONE
    try:
        return decode(Requester, query.attachment.to_bytes())
    except InvalidRequest:  # other tools of Zenoh attach what they like
        return ANYONE
