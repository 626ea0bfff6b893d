"""These tests need a Docker engine, and the images, which `make test-deploy` builds."""

from __future__ import annotations

from pathlib import Path

import pytest
from composition import engine_runs


class WithoutEngine(pytest.Module):
    """A module of tests that need an engine where none runs."""

    def collect(self) -> list[pytest.Item]:
        pytest.skip("the deployment is not tested: no Docker engine runs here", allow_module_level=True)


def pytest_pycollect_makemodule(module_path: Path, parent: pytest.Collector) -> pytest.Module | None:
    """Without an engine, a module is skipped."""
    return None if engine_runs() else WithoutEngine.from_parent(parent, path=module_path)
