"""How tests are spread over processes."""

from __future__ import annotations

import pytest


def test_xdist_knows_the_group_of_each_test(request: pytest.FixtureRequest, worker_id: str) -> None:
    if worker_id == "master":
        pytest.skip("all tests are in one process")
    group = request.node.get_closest_marker("xdist_group").args[0]
    assert request.node.nodeid.endswith(f"@{group}")
