"""When a trajectory passes its waypoints, and whether it comes close enough."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from zarm_geometry.robot_model import RobotModel
from zarm_planner.verification.verify import VerificationFailed
from zarm_trajectory.arrays import Array
from zarm_trajectory.trajectory import TimedTrajectory

_STEP = 0.001
"""Interval (s) of the samples."""
_SAMPLES_PER_BATCH = 5000
"""Samples processed in one batch, some milliseconds; a slow motion has many more."""


def passing_times(
    model: RobotModel,
    trajectory: TimedTrajectory,
    waypoints: Sequence[Array],
    position_tolerance: float,
    angle_tolerance: float,
    check: Callable[[], None] = lambda: None,
) -> tuple[float, ...]:
    """The times (s) at which the tip is nearest to its pose at any row of each of `waypoints` (n, dof), passed in this
    order.

    Raises VerificationFailed if one is not passed within `position_tolerance` (m) and `angle_tolerance` (rad). `check`
    is called now and then and may raise.
    """
    t = np.linspace(0.0, trajectory.duration, int(trajectory.duration / _STEP) + 2)
    tips = np.concatenate(
        [_tips(model, trajectory, t[k : k + _SAMPLES_PER_BATCH], check) for k in range(0, len(t), _SAMPLES_PER_BATCH)]
    )
    times: list[float] = []
    begin = 0
    for number, waypoint in enumerate(waypoints):
        looks = [_apart(tips[begin:], pose, check) for pose in model.fk_tip(waypoint.reshape(-1, model.dof))]
        distance, angle = np.stack(looks, axis=1)
        uses = np.maximum(distance / position_tolerance, angle / angle_tolerance)
        use = uses.min(axis=0)
        if use.min() > 1.0:
            which, k = np.unravel_index(int(np.argmin(uses)), uses.shape)
            raise VerificationFailed(
                f"the trajectory passes waypoint {number} at a distance of {1e3 * distance[which, k]:.1f} mm and "
                f"{np.rad2deg(angle[which, k]):.2f} deg"
            )
        first = int(np.argmax(use <= 1.0))
        outside = np.flatnonzero(use[first:] > 1.0)
        last = first + int(outside[0]) if len(outside) else len(use)
        begin += first + int(np.argmin(use[first:last]))
        times.append(float(t[begin]))
    return tuple(times)


def _tips(model: RobotModel, trajectory: TimedTrajectory, times: Array, check: Callable[[], None]) -> Array:
    """The poses (n, 4, 4) of the tip at `times` (n,) in s."""
    check()
    tips: Array = model.fk_tip(trajectory.positions(times))
    return tips


def _apart(tips: Array, wanted: Array, check: Callable[[], None]) -> Array:
    """The distances (2, n), in m and rad, of poses (n, 4, 4) from the wanted one (4, 4)."""
    check()
    distance = np.linalg.norm(tips[:, :3, 3] - wanted[:3, 3], axis=-1)
    # |A - B| = 2 sqrt(2) sin(angle / 2) in the Frobenius norm, for rotations A and B.
    apart = np.linalg.norm(tips[:, :3, :3] - wanted[:3, :3], axis=(-2, -1))
    return np.stack((distance, 2.0 * np.arcsin(np.minimum(apart / np.sqrt(8.0), 1.0))))
