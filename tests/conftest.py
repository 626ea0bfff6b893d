from __future__ import annotations

from collections.abc import Iterator

import pytest
from harness import router

from zarm_contract.bus import Bus


@pytest.fixture
def endpoint() -> Iterator[str]:
    """A router of this test's own."""
    with router() as address:
        yield address


@pytest.fixture
def bus(endpoint: str) -> Iterator[Bus]:
    """A client session on that router."""
    with Bus(endpoint) as session:
        yield session
