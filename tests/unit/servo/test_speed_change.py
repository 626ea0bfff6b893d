"""What a change of speed promises: from any state of any change to any velocity, inside the limits, and exactly."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from support.examples import examples
from zarm_servo.tracking.speed_change import SpeedChange

JOINTS = 5
STEP = 0.001


@pytest.mark.lengthy
@examples(1.0)
@given(seed=st.integers(0, 2**32 - 1))
def test_successive_velocities_are_reached_within_limits(seed: int) -> None:
    rng = np.random.default_rng(seed)
    velocity, acceleration = rng.uniform(0.5, 3.0, JOINTS), rng.uniform(0.5, 20.0, JOINTS)
    jerk = acceleration * rng.uniform(1.0, 500.0)
    state = np.zeros((3, JOINTS))
    for _ in range(8):
        wanted = velocity * rng.choice([-1.0, 0.0, 1.0, rng.uniform(-1.0, 1.0)], JOINTS)
        change = SpeedChange.to(wanted, state, acceleration, jerk)
        assert np.allclose(change.sample(np.array([change.duration]))[0, 0], _integral(change, state[0]), atol=1e-4)
        assert np.allclose(change.sample(np.array([0.0]))[:, 0], state, atol=1e-9)
        end = change.sample(change.duration + np.array([0.0, 1.0]))
        assert np.allclose(end[1], wanted, atol=1e-9)
        assert np.allclose(end[2], 0.0, atol=1e-9)
        assert np.allclose(end[0, 1] - end[0, 0], wanted, atol=1e-9)
        times = np.arange(0.0, change.duration + STEP, STEP)
        sampled = change.sample(times)
        assert np.all(np.abs(sampled[1]) <= velocity * (1 + 1e-9))
        assert np.all(np.abs(sampled[2]) <= acceleration * (1 + 1e-9))
        assert np.all(np.abs(np.diff(sampled[2], axis=0)) <= jerk * STEP * (1 + 1e-9) + 1e-12)
        state = sampled[:, rng.integers(len(times))]


def _integral(change: SpeedChange, start: np.ndarray) -> np.ndarray:
    """Where the velocities lead, by the trapezoidal rule."""
    times = np.linspace(0.0, change.duration, 20_001)
    v = change.sample(times)[1]
    return start + ((v[1:] + v[:-1]) / 2).sum(axis=0) * (change.duration / 20_000)
