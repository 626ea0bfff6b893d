"""ROS of the tests' own: a domain that nobody else is on, and nothing leaves this machine."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from support.ros.domain import isolate

if TYPE_CHECKING:
    from rclpy.node import Node

isolate()


class WithoutRos(pytest.Module):
    """A module of tests that need ROS where it is left out."""

    def collect(self) -> list[pytest.Item]:
        pytest.skip("the ROS bridge is left out here; `make ros` says what is missing", allow_module_level=True)


def pytest_pycollect_makemodule(module_path: Path, parent: pytest.Collector) -> pytest.Module | None:
    """Without ROS, a module is skipped before it imports any of it."""
    return None if find_spec("curobo_msgs") else WithoutRos.from_parent(parent, path=module_path)


@pytest.fixture
def node() -> Iterator[Node]:
    """A node of this process, whose callbacks run on a thread of their own."""
    from support.ros.node import running_node

    with ExitStack() as stack:
        yield stack.enter_context(running_node("test"))
