"""The projection of joint speeds onto linear bounds."""

from __future__ import annotations

import numpy as np

from zarm_geometry.kernels.compiled import brief
from zarm_trajectory.arrays import Array

ROUNDS = 20
"""Most iterations; the check of the step catches any remaining error."""
EXACT = 1e-5
"""The projection ends once no bound is violated by more than this (m/s)."""
FLAT = 1e-9
"""A bound whose gradient is shorter than the root of this says nothing about the joints."""


@brief
def projected(wanted: Array, inverse: Array, gradients: Array, least: Array) -> Array:
    """The speeds nearest to `wanted` (J,) whose product with each of the `gradients` (N, J) is at least its bound
    `least` (N,). Distances are measured in the metric with this `inverse` (J, J).

    Hildreth, "A quadratic programming procedure", 1957: each bound in turn pushes as far as it has to, and takes back
    what it pushed too far before.
    """
    bounds, joints = gradients.shape
    found, ways = wanted.copy(), np.zeros((bounds, joints))
    steep, force = np.zeros(bounds), np.zeros(bounds)
    for i in range(bounds):
        square = 0.0
        for j in range(joints):
            square += gradients[i, j] * gradients[i, j]
        if square <= FLAT:
            continue
        for j in range(joints):
            for k in range(joints):
                ways[i, j] += inverse[j, k] * gradients[i, k]
            steep[i] += gradients[i, j] * ways[i, j]
    for _ in range(ROUNDS):
        largest = 0.0
        for i in range(bounds):
            if steep[i] <= 0.0:
                continue
            rate = 0.0
            for j in range(joints):
                rate += gradients[i, j] * found[j]
            push = max(-force[i], (least[i] - rate) / steep[i])
            if push != 0.0:
                force[i] += push
                for j in range(joints):
                    found[j] += push * ways[i, j]
                largest = max(largest, abs(push) * steep[i])
        if largest < EXACT:
            break
    return found
