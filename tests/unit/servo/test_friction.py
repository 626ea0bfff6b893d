"""Friction is found in the efforts of motions, and then counts as what a motion needs."""

from __future__ import annotations

import numpy as np
import pytest

from zarm_contract.errors import Unavailable
from zarm_servo.guarding.friction import KEPT, LEAST, Friction, FrictionIdentification, direction_of

JOINTS = ("shoulder", "elbow", "wrist")
TRUE = Friction(np.array([3.0, 0.0, 0.5]), np.array([2.0, 1.5, 0.0]))


def moved(states: int, *, noise: float = 0.05, push: float = 0.0, seed: int = 0) -> FrictionIdentification:
    """What was seen in motions with the true friction, some noise (Nm), and at last a push (Nm)."""
    rng = np.random.default_rng(seed)
    found = FrictionIdentification(JOINTS)
    for velocity in rng.uniform(-1.5, 1.5, (states, len(JOINTS))):
        direction = direction_of(velocity)
        found.add(direction, velocity, TRUE.torque(direction, velocity) + rng.uniform(-noise, noise, len(JOINTS)))
    found.add(np.zeros(3), np.zeros(3), np.full(3, push))
    return found


def test_it_finds_dry_and_viscous_friction() -> None:
    found = moved(LEAST).estimate()
    assert found.joint_names == JOINTS
    np.testing.assert_allclose(found.dry, TRUE.dry, atol=0.02)
    np.testing.assert_allclose(found.viscous, TRUE.viscous, atol=0.02)
    assert found.states == LEAST + 1


def test_largest_is_what_friction_does_not_explain() -> None:
    np.testing.assert_allclose(moved(LEAST).estimate().largest, 0.05, atol=0.02)
    np.testing.assert_allclose(moved(LEAST, push=4.0).estimate().largest, 4.0, atol=0.02)


def test_friction_is_never_negative() -> None:
    helped = FrictionIdentification(JOINTS)
    rng = np.random.default_rng(0)
    for velocity in rng.uniform(-1.5, 1.5, (LEAST, len(JOINTS))):
        helped.add(direction_of(velocity), velocity, 0.5 * direction_of(velocity) - 0.1 * velocity)
    found = helped.estimate()
    assert min(*found.dry, *found.viscous) >= 0.0
    assert min(found.dry) > 0.3, "the best with one of them alone"


def test_a_joint_that_stands_still_has_no_friction() -> None:
    found = FrictionIdentification(JOINTS)
    for _ in range(LEAST):
        found.add(np.zeros(3), np.zeros(3), np.full(3, 0.7))
    estimate = found.estimate()
    assert estimate.dry == estimate.viscous == (0.0, 0.0, 0.0)
    np.testing.assert_allclose(estimate.largest, 0.7, atol=1e-3)


def test_too_few_states_are_refused_with_the_remedy() -> None:
    with pytest.raises(Unavailable, match=f"it takes {LEAST}; let the robot make the motions of its work"):
        moved(10).estimate()


def test_the_last_states_count() -> None:
    found = FrictionIdentification(JOINTS)
    velocity = np.array([1.0, -1.0, 0.5])
    for torque in (9.0, 1.0):
        for k in range(KEPT):
            v = velocity * (1.0 if k % 2 else -0.5)
            found.add(direction_of(v), v, torque * direction_of(v))
    np.testing.assert_allclose(found.estimate().dry, 1.0, atol=0.01)
    assert found.estimate().states == KEPT
