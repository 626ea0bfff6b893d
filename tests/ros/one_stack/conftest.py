"""These tests share one stack, which each module finds as it began. The folder needs its `__init__.py`: else the stack runs on to the end."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import pytest

import zarm
from zarm_contract.robot import load_robot

if TYPE_CHECKING:
    from support.ros.stack import Stack

HOME = load_robot("doosan_m1013").descriptor.home


@pytest.fixture(scope="package")
def shared(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Stack]:
    """The stack, which must outlive all of these tests."""
    from support.ros.stack import stack

    with stack(tmp_path_factory.mktemp("stack")) as started:
        yield started


@pytest.fixture(scope="module")
def running(shared: Stack) -> Stack:
    """The stack, with the emulated robot at rest at home in an empty scene."""
    with zarm.connect(shared.endpoint) as robot:
        robot.strategy("emulator")
        robot.scene.clear()
        robot.execute(robot.plan(HOME))
    return shared
