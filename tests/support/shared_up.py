"""A `zarm up` for all tests of a package that only use one. The folder needs an `__init__.py`; otherwise `up` runs
until the end.
"""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from support.command_line import KEYS, Up
from support.harness import free_endpoint
from support.paths import MESHES
from zarm_contract.messages import ClearScene, SceneEdit
from zarm_runtime.bus import Bus


@pytest.fixture(scope="package")
def up(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Up]:
    """`zarm up` with the meshes of the examples, shared by all of these tests: none of them stops it or changes its
    files.
    """
    with Up(free_endpoint(), tmp_path_factory.mktemp("up"), "--meshes", str(MESHES)) as stack:
        yield stack


@pytest.fixture
def place(up: Up) -> str:
    """Its endpoint."""
    return up.endpoint


@pytest.fixture
def observer(place: str) -> Iterator[Bus]:
    """A client on its bus, whose subscriptions end with the test."""
    with Bus(place) as session:
        yield session


@pytest.fixture
def empty_scene(observer: Bus) -> None:
    """Its scene is empty."""
    observer.call(KEYS.scene_edit, SceneEdit(edit=ClearScene(op="clear")), timeout=5)
