"""What the projection of joint speeds promises: bounds that can be met are met, at the least cost."""

from __future__ import annotations

import numpy as np
from scipy.optimize import minimize

from zarm_servo.kernels.projection import projected

JOINTS = 6


def test_the_nearest_bounded_speeds_are_those_of_a_solver() -> None:
    rng = np.random.default_rng(7)
    for _ in range(20):
        root = rng.normal(size=(JOINTS, JOINTS)) / 3
        metric = root @ root.T + 0.5 * np.eye(JOINTS)
        gradients, inside, wanted = rng.normal(size=(2, JOINTS)), rng.normal(size=JOINTS), rng.normal(size=JOINTS)
        least = gradients @ inside - rng.uniform(0.0, 0.2, 2)
        found = projected(wanted, np.linalg.inv(metric), gradients, least)
        assert np.all(gradients @ found >= least - 1e-3)
        best = minimize(
            lambda speed, metric=metric, wanted=wanted: (speed - wanted) @ metric @ (speed - wanted),
            inside,
            constraints={"type": "ineq", "fun": lambda speed, g=gradients, b=least: g @ speed - b},
        )
        np.testing.assert_allclose(found, best.x, rtol=0, atol=5e-3)


def test_a_bound_that_no_joint_can_change_is_left_out() -> None:
    wanted = np.ones(JOINTS)
    found = projected(wanted, np.eye(JOINTS), np.array((np.zeros(JOINTS), np.eye(JOINTS)[0])), np.array((1.0, 2.0)))
    np.testing.assert_allclose(found, (2.0, *wanted[1:]), rtol=0, atol=1e-6)
