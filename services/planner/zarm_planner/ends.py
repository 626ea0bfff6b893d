"""The two ends of a path: where the robot is and where it may go, and the nearest places from which the search can work.

Spheres are larger than the links that they cover. So a robot that holds its tool close to a table, and touches nothing,
seems to touch it; from there it first moves a little away, on a straight edge that exact geometry finds free.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from zarm_contract.errors import PlanningFailed
from zarm_contract.messages import JointGoal, PoseGoal, SceneRevision
from zarm_geometry.collision import is_free
from zarm_geometry.exact import RESOLUTION, ExactScene, Nearest
from zarm_geometry.frames import matrix
from zarm_geometry.robot_model import RobotModel
from zarm_geometry.world import World
from zarm_planner.held import Held
from zarm_planner.ik import solve_ik
from zarm_planner.joints import within_range
from zarm_planner.motion import Array
from zarm_planner.stop import Stop

_GOALS = 16
"""At most so many ways to reach a pose are considered."""
_TRIES = 40
"""Directions tried at each distance to get away from an obstacle."""
_DISTANCES = (0.02, 0.05, 0.1, 0.2, 0.4, 0.8)
"""Rad, Euclidean."""


@dataclass(frozen=True)
class Snapshot:
    """One scene as plans use it: the robot as it is in it, the obstacles with their margin, and exact geometry."""

    revision: SceneRevision
    model: RobotModel
    world: World
    exact: ExactScene


@dataclass(frozen=True)
class End:
    """A configuration that was asked for, and one for the search, free in spheres: itself where it is; (dof,) each."""

    asked: Array
    free: Array

    @property
    def edge(self) -> Array:
        """The way from the free one to the other: no row, or the one that was asked for."""
        return self.asked[None][: 0 if self.free is self.asked else 1]


def start_end(snapshot: Snapshot, q: Array, held: Held | None, seed: int, stop: Stop) -> End:
    """The start of a path. Raises PlanningFailed (`start_in_collision`)."""
    nearest = snapshot.exact.nearest(q)
    if nearest.distance <= 0.0:
        raise PlanningFailed(
            f"the start is in collision: {_overlap(nearest)}; move the robot away by hand, or correct the scene",
            code="start_in_collision",
            field="start",
        )
    if (end := _end(snapshot, q, held, seed, stop)) is None:
        raise PlanningFailed(
            f"there is no way out of the start, where {_gap(nearest)}; move the robot away by hand, or lower margin",
            code="start_in_collision",
            field="start",
        )
    return end


def goal_ends(
    snapshot: Snapshot, start: Array, goal: PoseGoal | JointGoal, field: str, held: Held | None, seed: int, stop: Stop
) -> list[End]:
    """The configurations that reach a goal, which is the request's `field`; the one nearest to `start` first.

    Raises PlanningFailed (`unreachable`, `goal_in_collision`), InvalidRequest for joints out of their range, and what
    `stop` raises.
    """
    model = snapshot.model
    match goal:
        case JointGoal():
            candidates = np.array([within_range(model, goal.position, f"{field}.position")])
        case PoseGoal():
            pose = matrix(goal.position, goal.orientation)
            found = solve_ik(model, pose, start, world=snapshot.world, max_solutions=_GOALS, seed=seed, stop=stop)
            stop.check()
            if len(found.solutions):
                return [End(q, q) for q in found.solutions]
            candidates = found.colliding[:_GOALS]
            if not len(candidates):
                raise PlanningFailed(
                    f"the goal cannot be reached: the tip comes within {1e3 * found.distance:.1f} mm and "
                    f"{np.rad2deg(found.angle):.1f} deg of it at best; choose a pose nearer to the robot or another orientation",
                    code="unreachable",
                    field=field,
                )
    ends: list[End] = []
    obstacles = []
    for q in candidates:
        nearest = snapshot.exact.nearest(q)
        if nearest.distance > 0.0 and (end := _end(snapshot, q, held, seed, stop)):
            ends.append(end)
        else:
            obstacles.append(nearest)
    if not ends:
        nearest = max(obstacles, key=lambda nearest: nearest.distance)
        reason = f"in collision: {_overlap(nearest)}" if nearest.distance <= 0.0 else f"out of reach: {_gap(nearest)}"
        ways = f" in all {len(candidates)} ways to reach it" if len(candidates) > 1 else ""
        raise PlanningFailed(
            f"the goal is{ways} {reason}; choose another one, lower margin, or correct the scene",
            code="goal_in_collision",
            field=field,
        )
    return ends


def _end(snapshot: Snapshot, q: Array, held: Held | None, seed: int, stop: Stop) -> End | None:
    """The end at `q`, which is free of collision; None where no way that keeps what is held leads to what is free in spheres."""
    if is_free(snapshot.model, snapshot.world, q):
        return End(q, q)
    model, random = snapshot.model, np.random.default_rng(seed)
    for distance in _DISTANCES:
        for direction in random.normal(size=(_TRIES, model.dof)):
            stop.check()
            near = np.clip(q + distance * direction / np.linalg.norm(direction), model.lower, model.upper)
            if held is not None:
                if (kept := held.projected(near)) is None:
                    continue
                near = kept[0]
            if is_free(model, snapshot.world, near):
                steps = int(np.abs(near - q) @ snapshot.exact.reach / RESOLUTION) + 2
                way = np.linspace(q, near, steps)
                if (held is None or held.use(way).max() <= 1.0) and snapshot.exact.nearest(way).distance > 0.0:
                    return End(q, near)
    return None


def _overlap(nearest: Nearest) -> str:
    a, b = nearest.pair or ("", "")
    return f"{a} is {-1e3 * nearest.distance:.1f} mm inside {b}"


def _gap(nearest: Nearest) -> str:
    a, b = nearest.pair or ("", "")
    return f"{a} is only {1e3 * nearest.distance:.1f} mm from {b}"
