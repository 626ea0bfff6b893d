"""The beginning of a motion that starts moving: a past for the moving average, and braking to rest.

Smoothing averages ramps over a window of time. For the average to have a given position, velocity and acceleration at
time 0, the ramps need a past as long as the window: in it each joint first changes its velocity by the window times
that acceleration, as fast as it can, and then keeps it. So the ramps begin no faster than the motion becomes when its
acceleration is released.
"""

from __future__ import annotations

from collections.abc import Iterator
from copy import deepcopy
from dataclasses import dataclass

import numpy as np

from zarm_geometry.robot_model import RobotModel
from zarm_geometry.working_memory import working_memory
from zarm_geometry.world import World
from zarm_planner.kernels.lead_in import brake
from zarm_planner.kernels.ramps import Ramps, make_ramps
from zarm_planner.timing.averaging import DEVIATION, MIN_AVERAGING_TIME, Averaging
from zarm_planner.timing.sampling import TOLERANCE
from zarm_trajectory.arrays import Array
from zarm_trajectory.limits import Limits

_MAX_BRAKING_MOTIONS = 300
"""Ways to brake that are tried; each that is not free takes some 20 us."""
_EXACT_WAYS = 20
"""The same among those that are not free in spheres."""


@dataclass(frozen=True)
class LeadIn:
    """The beginning of a motion at `state` (3, dof): position, velocity and acceleration.

    `ramps` are two: the past, `window` s long, and a braking with at most `strongest` (dof,) rad/s^2 to rest at `rest`
    (dof,). `fastest` (dof,) in rad/s may slightly exceed the limits if the motion begins that fast.
    """

    state: Array
    rest: Array
    ramps: Ramps
    window: float
    fastest: Array
    strongest: Array


def ways_to_rest(
    model: RobotModel,
    world: World,
    state: Array,
    limits: Limits,
    dt: float,
    *,
    vias: bool,
    seed: int,
    share: float = 1.0,
    soon: bool = False,
) -> Iterator[LeadIn]:
    """Ways to brake from `state` (3, dof) inside the joint ranges: first one that is free in spheres, if any, then
    others.

    They accelerate by at most a `share` of the limits; with `vias` as gently as `smooth_path` does in that case. Averaging
    is chosen for a motion through the joint ranges, or for coming to rest `soon`.
    """
    q, velocity, acceleration = state
    # A motion from one end of the range to the other, or once around.
    ways = np.zeros(model.dof) if soon else np.minimum(model.upper - model.lower, 2 * np.pi)
    used = Averaging.of(
        ways,
        np.stack((limits.velocity, share * limits.acceleration, limits.jerk)),
        MIN_AVERAGING_TIME * dt,
        deviation=DEVIATION if vias else np.inf,
        begun=acceleration,
        velocity=velocity,
    )
    strongest, window = used.acceleration, used.window
    strength = np.maximum(strongest, np.abs(acceleration))
    change = window * np.abs(acceleration) / strength
    begun = velocity + acceleration * 0.5 * change
    ramps = make_ramps(2, model.dof)
    ramps.via[:] = False
    ramps.duration[0] = window
    ramps.acceleration[0] = np.copysign(strength, acceleration)
    ramps.first[0], ramps.last[0] = change, 0.0
    ramps.velocity[0] = begun - window * acceleration
    # The average over the past is `q`, so the past starts at `q` minus its average displacement.
    ramps.position[0] = q - (
        0.5 * window * ramps.velocity[0]
        + ramps.acceleration[0]
        * (change**3 / 6 + 0.5 * change**2 * (window - change) + 0.5 * change * (window - change) ** 2)
        / window
    )
    ramps.position[1] = ramps.position[0] + window * velocity
    ramps.velocity[1] = begun
    fastest = np.maximum(used.velocity, np.minimum(np.abs(begun), (1 + TOLERANCE) * limits.velocity))
    bounds = np.stack((np.minimum(model.lower, q), np.maximum(model.upper, q), fastest, strongest))
    random = np.array([seed], np.uint64)

    def way(first: int, most: int, checked: bool) -> int:
        return brake(
            model.arrays, world.arrays, working_memory(model.arrays), ramps, 1, bounds, first, most, checked, random
        )

    def lead_in() -> LeadIn:
        kept = deepcopy(ramps)
        first, last, a = kept.first[1], kept.last[1], kept.acceleration[1]
        peak = kept.velocity[1] + a * first
        rest = kept.position[1] + (
            kept.velocity[1] * first + 0.5 * a * first**2 + peak * (kept.duration[1] - first) - 0.5 * a * last**2
        )
        return LeadIn(state, rest, kept, window, fastest, strongest)

    if way(0, _MAX_BRAKING_MOTIONS, True) >= 0:
        yield lead_in()
    number = -1
    while (number := way(number + 1, _EXACT_WAYS, False)) >= 0:
        yield lead_in()
