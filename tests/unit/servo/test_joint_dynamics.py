"""Friction and the inertia of motors are found in the efforts of motions, and then count as what a motion needs."""

from __future__ import annotations

import numpy as np
import pytest

from zarm_contract.errors import Unavailable
from zarm_geometry.dynamics import JointDynamics
from zarm_servo.guarding.joint_dynamics import MIN_STATES, STATES_KEPT, Identification, Moving, unexplained
from zarm_trajectory.arrays import Array

JOINTS = ("shoulder", "elbow", "wrist")
TRUE = JointDynamics(np.array([3.0, 0.0, 0.5]), np.array([2.0, 1.5, 0.0]), np.array([0.4, 0.1, 0.0]))
REST = Moving.over(np.zeros((2, 3)), np.zeros(3))


def moving(rng: np.random.Generator) -> Moving:
    """A state of fast joints."""
    velocity = rng.choice((-1.0, 1.0), 3) * rng.uniform(0.3, 1.5, 3)
    return Moving.over(np.array([velocity, velocity]), rng.uniform(-5.0, 5.0, 3))


def needed(joints: JointDynamics, state: Moving) -> Array:
    return (
        joints.friction * np.sign(state.velocity)
        + joints.damping * state.velocity
        + joints.armature * state.acceleration
    )


def identified(states: int, joints: JointDynamics = TRUE, *, noise: float = 0.05) -> Identification:
    """What was seen in motions of such joints, with some noise (Nm)."""
    rng, found = np.random.default_rng(0), Identification(JOINTS)
    for _ in range(states):
        state = moving(rng)
        found.add(state, needed(joints, state) + rng.uniform(-noise, noise, 3))
    return found


def test_it_finds_friction_damping_and_armature() -> None:
    found = identified(MIN_STATES).found()
    assert found.joint_names == JOINTS
    np.testing.assert_allclose(found.friction, TRUE.friction, atol=0.02)
    np.testing.assert_allclose(found.damping, TRUE.damping, atol=0.02)
    np.testing.assert_allclose(found.armature, TRUE.armature, atol=0.01)
    assert found.states == MIN_STATES


def test_largest_is_what_they_do_not_explain() -> None:
    seen = identified(MIN_STATES)
    np.testing.assert_allclose(seen.found().largest, 0.05, atol=0.02)
    seen.add(REST, np.array([5.0, 4.0, 4.5]))
    np.testing.assert_allclose(seen.found().largest, [2.0, 4.0, 4.0], atol=0.1, err_msg="friction may hold the rest")


def test_nothing_found_is_negative() -> None:
    helped = JointDynamics(np.full(3, 0.5), np.full(3, -0.1), np.full(3, -0.2))
    found = identified(MIN_STATES, helped).found()
    assert min(*found.friction, *found.damping, *found.armature) >= 0.0
    assert min(found.friction) > 0.3, "the best without the others"


def test_a_joint_that_stands_still_needs_nothing() -> None:
    seen = Identification(JOINTS)
    for _ in range(MIN_STATES):
        seen.add(REST, np.full(3, 0.7))
    found = seen.found()
    assert found.friction == found.damping == found.armature == (0.0, 0.0, 0.0)
    np.testing.assert_allclose(found.largest, 0.7, atol=1e-3)


def test_too_few_states_are_refused_with_the_remedy() -> None:
    with pytest.raises(
        Unavailable, match=f"at least {MIN_STATES} are needed; let the robot make the motions of its work"
    ):
        identified(10).found()


def test_the_last_states_count() -> None:
    seen, rng = Identification(JOINTS), np.random.default_rng(0)
    for friction in (9.0, 1.0):
        joints = JointDynamics(np.full(3, friction), np.zeros(3), np.zeros(3))
        for _ in range(STATES_KEPT):
            state = moving(rng)
            seen.add(state, needed(joints, state))
    found = seen.found()
    np.testing.assert_allclose(found.friction, 1.0, atol=0.01)
    assert found.states == STATES_KEPT


@pytest.mark.parametrize("velocity", [1.0, -1.0])
def test_a_push_on_a_moving_joint_remains_whole(velocity: float) -> None:
    state = Moving.over(np.full((2, 3), velocity), np.full(3, 2.0))
    remaining = unexplained(TRUE, needed(TRUE, state) + 2.0, state)
    np.testing.assert_allclose(remaining, 2.0, atol=1e-6)


def test_of_a_joint_that_turns_round_friction_may_act_either_way() -> None:
    turning = Moving.over(np.array([[0.02] * 3, [-0.02] * 3]), np.zeros(3))
    for direction in (-1.0, 1.0):
        np.testing.assert_allclose(unexplained(TRUE, direction * TRUE.friction, turning), 0.0, atol=1.2)
    assert unexplained(TRUE, np.full(3, 8.0), turning).min() > 4.0, "a harder push is felt all the same"
