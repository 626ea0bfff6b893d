from __future__ import annotations

from collections.abc import Iterator

import pytest
from harness import router
from hypothesis import settings

from zarm_contract.bus import Bus

settings.register_profile("untimed", deadline=None)  # nothing timed is asserted: machines differ
settings.load_profile("untimed")


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
