"""The margins that a verified trajectory could not keep."""

from __future__ import annotations

from collections.abc import Callable

from zarm_contract.messages import TooNear
from zarm_geometry.exact import RESOLUTION
from zarm_planner.kernels.quintic import followed
from zarm_planner.scene.planning_scene import PlanningScene
from zarm_trajectory.trajectory import TimedTrajectory


def too_near(
    scene: PlanningScene, trajectory: TimedTrajectory, clearance: float, check: Callable[[], None]
) -> tuple[TooNear, ...]:
    """The pairs closer to each other along a trajectory of this `clearance` (m) than the scene's margins, in exact
    geometry.

    `check` is called now and then and may raise.
    """
    exact = scene.exact
    times, position = followed(
        trajectory.time, trajectory.position, trajectory.velocity, trajectory.acceleration, exact.reach, RESOLUTION
    )
    return tuple(
        TooNear(pair=nearest.pair, distance=nearest.distance, margin=kept, time=float(times[nearest.sample]))
        for nearest, kept in exact.too_near(position, clearance, scene.world.margin, scene.self_margin, check)
        if nearest.pair is not None
    )
