"""Verification: a trajectory leaves the planner only if it meets the whole request, between its samples too."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from zarm_geometry.exact import RESOLUTION, ExactScene
from zarm_planner.constraints.path_constraint import ConstraintManifold
from zarm_planner.kernels.quintic import followed
from zarm_planner.kernels.verification import first_missed, furthest_outside
from zarm_planner.timing.sampling import TOLERANCE, load
from zarm_trajectory.arrays import Array
from zarm_trajectory.limits import Limits
from zarm_trajectory.trajectory import TimedTrajectory

_POSITION = 1e-6
"""Rad by which a motion may miss its start and its goal."""
LOAD = 1 + 1.5 * TOLERANCE
"""Largest permitted `sampling.load`: that of the timing, and some rounding."""
_MISSED = (
    "starts away from the start",
    "ends away from the goal",
    "does not start at the velocity of the start",
    "does not start at the acceleration of the start",
    "does not end at rest",
)
"""What a trajectory does that misses a condition of `first_missed`."""
RANGE = 1e-4
"""Rad by which a joint may be outside its range: rounding, and interpolation between samples."""


_REMEDY = "allow more time or attempts, or, against collisions, a larger margin"


class VerificationFailed(Exception):
    """A trajectory fails verification; the message says in what, where and by how much, `time` at how many s of it.

    `fraction` (0..1) says how far along a curve that is, `remedy` what helps.
    """

    def __init__(self, message: str, time: float | None = None, remedy: str = _REMEDY) -> None:
        super().__init__(message)
        self.time = time
        self.remedy = remedy
        self.fraction: float | None = None


def verify(
    trajectory: TimedTrajectory,
    start: Array,
    goal: Array,
    limits: Limits,
    scene: ExactScene,
    check: Callable[[], None],
    constraint: ConstraintManifold | None = None,
    motion: Array | None = None,
) -> float:
    """The trajectory's smallest distance (m) to the scene and to the robot itself, at most 1.

    Raises VerificationFailed unless the trajectory leads from `start` to `goal` (dof,), from rest, or from the velocity
    and acceleration `motion` (2, dof), to rest, inside the joint ranges and `limits`, and free of collision. Between
    the configurations checked, no point of the robot moves further than `RESOLUTION`; `constraint` is checked at the
    same ones. `check` is called now and then and may raise.
    """
    model, joints = scene.model, scene.model.robot.descriptor.joints
    position, velocity, acceleration = trajectory.position, trajectory.velocity, trajectory.acceleration
    begun = np.zeros((2, model.dof)) if motion is None else motion
    missed = first_missed(position, velocity, acceleration, start, goal, begun, _POSITION)
    if missed >= 0:
        raise VerificationFailed(f"the trajectory {_MISSED[missed]}")
    if not (used := load(trajectory, limits)) <= LOAD:
        raise VerificationFailed(f"the trajectory needs {used:.4g} times the allowed speed")

    times, position = followed(trajectory.time, position, velocity, acceleration, scene.reach, RESOLUTION)
    outside, sample, joint = furthest_outside(position, model.lower, model.upper)
    if not outside <= RANGE:
        raise VerificationFailed(
            f"the trajectory takes {joints[joint]} {outside:.4f} rad out of its range at {times[sample]:.2f} s"
        )
    if constraint is not None and (lost := constraint.violation(position)):
        raise VerificationFailed(f"{lost[1]} at {times[lost[0]]:.2f} s of the trajectory")
    nearest = scene.nearest(position, check)
    if nearest.distance <= 0.0 and nearest.pair:
        raise VerificationFailed(
            f"{nearest.pair[0]} would be {-1e3 * nearest.distance:.1f} mm inside {nearest.pair[1]} at "
            f"{times[nearest.sample]:.2f} s of the trajectory",
            float(times[nearest.sample]),
        )
    return nearest.distance
