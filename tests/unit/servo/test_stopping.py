"""How long the servo reckons with until a robot begins to brake."""

from __future__ import annotations

from pathlib import Path

import pytest

from support.composed import composed, two_pandas
from support.led_cell import CELL
from zarm_contract.robot import load_robot
from zarm_servo.guarding.stopping import reaction


def test_other_executors_take_the_descriptor_s_delay(tmp_path: Path) -> None:
    apart, alone = tmp_path / "apart", tmp_path / "alone"
    apart.mkdir()
    alone.mkdir()
    descriptor = load_robot(str(composed(apart, CELL))).descriptor
    timing = descriptor.command_timing
    assert timing is not None
    waited = reaction(descriptor) - reaction(load_robot(str(two_pandas(alone))).descriptor)
    assert waited == pytest.approx(timing.delay + timing.chunk_period + timing.look_ahead)
    assert waited > 0.3
