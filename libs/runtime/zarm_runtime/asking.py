"""Who sent the request that is being answered."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

import zenoh

from zarm_contract.codec import decode
from zarm_contract.errors import InvalidRequest
from zarm_contract.messages import Asker

ANYONE = Asker.model_construct(client="", patience=math.inf)
"""Whoever does not say who it is, all of them together: any Zenoh client, and calls within one process."""

_asker: ContextVar[Asker] = ContextVar("asker", default=ANYONE)


def asker() -> Asker:
    """Who asks for what this thread works on."""
    return _asker.get()


@contextmanager
def asked_by(who: Asker) -> Iterator[None]:
    """Have `asker` return `who` in this thread."""
    before = _asker.set(who)
    try:
        yield
    finally:
        _asker.reset(before)


def asker_of(query: zenoh.Query) -> Asker:
    """Who sent a query; ANYONE where its attachment does not say so."""
    if query.attachment is None:
        return ANYONE
    try:
        return decode(Asker, query.attachment.to_bytes())
    except InvalidRequest:  # other tools of Zenoh attach what they like
        return ANYONE
