"""The least times of legs, against their definition in NumPy."""

from __future__ import annotations

import numpy as np
import pytest

from zarm_planner.kernels.leg_times import path_time, straight_times

FASTEST, STRONGEST = np.array((1.0, 2.0, 0.5)), np.array((3.0, 1.0, 10.0))


def with_ramps(way: np.ndarray, rests: int) -> np.ndarray:
    """Each joint's time for a way: at full speed, after as many ramps as ends rest; or only ramps if it is short."""
    ramp = FASTEST / STRONGEST
    short = way < rests * 0.5 * FASTEST * ramp
    return np.where(short, np.sqrt(2 * rests * way / STRONGEST), way / FASTEST + 0.5 * rests * ramp)


@pytest.mark.parametrize("rests", [0, 1, 2])
def test_a_straight_leg_takes_its_slowest_joint(rests: int) -> None:
    rng = np.random.default_rng(rests)
    starts, goals = rng.uniform(-2, 2, (3, 3)), rng.uniform(-2, 2, (20, 3))
    goals[:5] = starts[0] + rng.uniform(-0.05, 0.05, (5, 3))
    found = straight_times(starts, goals, FASTEST, STRONGEST, rests)
    expected = with_ramps(np.abs(goals[None] - starts[:, None]), rests).max(axis=2)
    np.testing.assert_allclose(found, expected, rtol=1e-12)


@pytest.mark.parametrize("rests", [0, 1, 2])
def test_a_path_takes_the_slowest_joint_of_each_edge_or_of_all(rests: int) -> None:
    rng = np.random.default_rng(rests)
    slower = {"edges": 0, "joints": 0}
    for _ in range(200):
        path = np.cumsum(rng.normal(size=(rng.integers(1, 6), 3)) * rng.uniform(0, 0.5, (1, 3)), axis=0)
        ways = np.abs(np.diff(path, axis=0))
        edges, joints = (ways / FASTEST).max(axis=1, initial=0.0).sum(), with_ramps(ways.sum(axis=0), rests).max()
        assert path_time(path, FASTEST, STRONGEST, rests) == pytest.approx(max(edges, joints), rel=1e-12)
        slower["edges" if edges > joints else "joints"] += 1
    assert min(slower.values()) > 0
