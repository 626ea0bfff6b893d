"""Collision checks of configurations, and the cells that objects occupy, answered."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from zarm_contract.messages import (
    CheckRequest,
    CheckResult,
    CheckResults,
    HoldingTorque,
    Occupancy,
    OccupancyRequest,
    Vector3,
)
from zarm_geometry.dynamics import Dynamics
from zarm_geometry.occupancy import reached_cells
from zarm_geometry.sphere_distances import sphere_distances
from zarm_planner.deadline import Deadline
from zarm_planner.goals.joints import checked
from zarm_planner.handlers.state import BATCH_TIMEOUT, PlannerState
from zarm_runtime.requester import requester
from zarm_trajectory.arrays import Array


class CheckHandlers:
    """Answers requests about the present scene."""

    def __init__(self, state: PlannerState) -> None:
        self._state = state

    def check(self, request: CheckRequest) -> CheckResults:
        """Exact distances of configurations. Raises InvalidRequest, or ExecutionRefused if nothing is measured."""
        model = self._state.model
        if request.joints is None:
            joints = [self._state.measured()]
        else:
            joints = [checked(model, q, f"joints.{i}") for i, q in enumerate(request.joints)]

        def work(deadline: Deadline) -> CheckResults:
            openings = self._state.grippers.present()
            scene, results = self._state.scenes.present(self._state.settings.margin, openings=openings), []
            whole = model.with_attached((), (), openings) if request.spheres else model
            for q in joints:
                deadline.check()
                nearest = scene.exact.nearest(q, deadline.check)
                spheres = tuple(sphere_distances(whole, scene.world, q).tolist()) if request.spheres else None
                points = scene.exact.nearest_points(q, nearest) if request.points else None
                dynamics = scene.exact.model.dynamics if request.torque else None
                results.append(
                    CheckResult(
                        in_collision=nearest.distance <= 0.0,
                        within_limits=bool(np.all((q >= model.lower) & (q <= model.upper))),
                        clearance=nearest.distance,
                        pair=nearest.pair,
                        spheres=spheres,
                        points=None if points is None else _two(points),
                        holding=None if dynamics is None else _holding(dynamics, q),
                    )
                )
            return CheckResults(results=tuple(results))

        return self._state.scheduler.run(work, requester(), BATCH_TIMEOUT)

    def occupancy(self, request: OccupancyRequest) -> Occupancy:
        """The cells of a grid that the scene's objects reach into. Raises InvalidRequest if there are too many."""

        def work(deadline: Deadline) -> Occupancy:
            scene = self._state.scenes.present(self._state.settings.margin)
            cells = reached_cells(scene.world, request.resolution, deadline.check)
            return Occupancy.model_construct(  # its cells were just counted, and validation is slower
                scene_revision=scene.revision,
                resolution=request.resolution,
                cells=tuple(map(tuple, cells.tolist())),
            )

        return self._state.scheduler.run(work, requester(), BATCH_TIMEOUT)


def _holding(dynamics: Dynamics, q: Array) -> tuple[HoldingTorque, ...]:
    """The torques that hold the robot at joints (dof,)."""
    torques, efforts = dynamics.holding(q[None])[0].tolist(), dynamics.limit.tolist()
    return tuple(
        HoldingTorque(torque=torque, effort=effort if math.isfinite(effort) else None)
        for torque, effort in zip(torques, efforts, strict=True)
    )


def _two(points: NDArray[np.float64]) -> tuple[Vector3, Vector3]:
    """Two points (2, 3) in their message form."""
    (ax, ay, az), (bx, by, bz) = points.tolist()
    return (ax, ay, az), (bx, by, bz)
