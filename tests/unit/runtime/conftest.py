from __future__ import annotations

from collections.abc import Iterator

import pytest
import zenoh

from zarm_runtime.bus import Bus
from zarm_runtime.session import open_client


@pytest.fixture
def other(endpoint: str) -> Iterator[Bus]:
    """A second session on the router of `bus`: another process, as far as the router can tell."""
    with Bus(endpoint) as session:
        yield session


@pytest.fixture
def plain(endpoint: str) -> Iterator[zenoh.Session]:
    """A third one, of a program that knows nothing of zarm."""
    with open_client(endpoint) as session:
        yield session
