"""A driver's one number is read as the share of the last command that it has played, however the driver counts."""

from __future__ import annotations

import numpy as np
from hypothesis import example, given
from hypothesis import strategies as st

from zarm_ros_bridge.drivers.progress import ProgressReader


def test_before_a_command_nothing_is_said() -> None:
    assert ProgressReader().read(0.5) is None


def test_of_a_stop_nothing_is_said() -> None:
    reader = ProgressReader()
    reader.sent(1, 10)
    reader.read(0.1)
    reader.sent(2, 0)
    assert reader.read(0.2) is None


COMMANDS = st.lists(st.tuples(st.integers(1, 400), st.floats(0, 1)), min_size=1, max_size=6)
"""Points of each command, and the share of them that is played before the next one."""


def _single(value: float) -> float:
    return float(np.float32(value))


@given(COMMANDS)
def test_per_command_progress_is_never_overestimated(
    commands: list[tuple[int, float]],
) -> None:
    reader = ProgressReader()
    for sequence, (points, share) in enumerate(commands, start=1):
        reader.sent(sequence, points)
        count = max(1, round(points * share))
        for played in range(1, 1 + count):
            progress = reader.read(_single(played / points))
            assert progress is not None
            assert progress.sequence == sequence
            assert progress.fraction * points < played + 0.1
        if count == points:
            assert progress.fraction > 1.0 - 1e-4  # single precision, of the whole count


@given(COMMANDS)
@example([(227, 0.30078125), (50, 1.0)])
@example([(42, 0.75), (1, 0.0)])
@example([(100, 0.3), (50, 1.0)])
def test_cumulative_progress_is_never_overestimated(
    commands: list[tuple[int, float]],
) -> None:
    reader = ProgressReader()
    counter = total = 0
    for sequence, (points, share) in enumerate(commands, start=1):
        reader.sent(sequence, points)
        total = total or points
        count = max(1, round(points * share))
        for played in range(1, 1 + count):
            counter += 1
            progress = reader.read(_single(counter / total))
            assert progress is not None
            assert progress.sequence == sequence
            assert progress.fraction * points < played + 0.1
        if count == points:
            assert progress.fraction > 1.0 - 1e-4  # single precision, of the whole count
            counter = total = 0
