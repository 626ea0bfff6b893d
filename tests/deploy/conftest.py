"""These tests need a Docker engine, and the images, which `make test-deploy` builds."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from support.deploy.composition import docker, image

_built = shutil.which("docker") and docker("image", "inspect", image("leeloo_sim"), check=False).returncode == 0


class WithoutImages(pytest.Module):
    """A module of tests that need the images where there are none."""

    def collect(self) -> list[pytest.Item]:
        pytest.skip(
            "the deployment is not tested: no Docker engine, or no images (`make test-deploy`)", allow_module_level=True
        )


def pytest_pycollect_makemodule(module_path: Path, parent: pytest.Collector) -> pytest.Module | None:
    """Without images, a module is skipped."""
    return None if _built else WithoutImages.from_parent(parent, path=module_path)
