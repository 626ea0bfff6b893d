"""Whether the tip keeps to its curve, between the samples of a trajectory too."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from zarm_geometry.exact import RESOLUTION, ExactScene
from zarm_planner.cartesian.task import ANGLE, DISTANCE, ToolTask
from zarm_planner.cartesian.timing import Progress
from zarm_planner.kernels.quintic import followed
from zarm_planner.verification.verify import VerificationFailed
from zarm_trajectory.trajectory import TimedTrajectory

_ENDS = 1e-6
"""Share of the curve by which a motion may miss its ends."""


def first_contact(
    scene: ExactScene, trajectory: TimedTrajectory, progress: Progress, check: Callable[[], None]
) -> VerificationFailed:
    """The failure of a trajectory that collides: where it first does, and how far along its curve that is."""
    times, position = followed(
        trajectory.time, trajectory.position, trajectory.velocity, trajectory.acceleration, scene.reach, RESOLUTION
    )
    free, touching = 0, len(times)  # so many configurations are free; so many contain one that is not
    while touching - free > 1:
        middle = (free + touching) // 2
        if scene.is_free(position[:middle], check):
            free = middle
        else:
            touching = middle
    time = float(times[free])
    a, b = scene.nearest(position[free], check).pair or ("the robot", "itself")
    failure = VerificationFailed(f"there {a} would touch {b}, at {time:.2f} s of the trajectory", time)
    failure.fraction = progress.fraction(time)
    return failure


def verify_tool_path(task: ToolTask, trajectory: TimedTrajectory, progress: Progress) -> None:
    """Raises VerificationFailed unless the tip moves from one end of the curve to the other, never back, within DISTANCE
    and ANGLE.
    """
    times, parameters = progress.times, progress.samples[0][:, 0]
    end = float(task.curve.stations[-1])
    if abs(parameters[0]) > _ENDS * end or abs(parameters[-1] - end) > _ENDS * end:
        raise VerificationFailed("the trajectory does not lead from one end of the curve to the other")
    if np.diff(parameters).min() < -_ENDS * end:
        raise VerificationFailed("the trajectory moves back along the curve")
    used = task.use(np.clip(parameters, 0.0, end), trajectory.positions(times))
    worst = int(np.argmax(used))
    if used[worst] > 1.0:
        raise VerificationFailed(
            f"the tip would leave the curve by {used[worst]:.2f} times the permitted {1e3 * DISTANCE:g} mm and "
            f"{np.rad2deg(ANGLE):g} deg at {times[worst]:.2f} s of the trajectory"
        )
