"""What the servo reads from the bus reaches all its parts."""

from __future__ import annotations

import logging
from types import SimpleNamespace
from typing import Any

import pytest

from support.trajectories import ROBOT
from zarm_contract.messages import Scene
from zarm_geometry.meshes import Meshes
from zarm_servo.world.world_monitor import WorldMonitor


def test_a_part_that_fails_keeps_no_change_from_the_others(caplog: pytest.LogCaptureFixture) -> None:
    measured: Any = SimpleNamespace(get=lambda max_age=1.0: None)
    world, told = WorldMonitor(measured, Meshes(), ROBOT.descriptor), []

    def fails() -> None:
        raise RuntimeError("it fails")

    world.on_change += [fails, lambda: told.append(True)]
    with caplog.at_level(logging.ERROR):
        world.scene.on_scene("", Scene(revision="1-5be0c1d2f3a4"))
    assert told == [True]
    assert "it fails" in caplog.text
