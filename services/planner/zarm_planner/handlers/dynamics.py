"""Torques of motions, answered."""

from __future__ import annotations

import math

import numpy as np

from zarm_contract.messages import InverseDynamics, InverseDynamicsRequest
from zarm_planner.goals.joints import checked
from zarm_planner.handlers.state import PlannerState
from zarm_trajectory.arrays import Array


class DynamicsHandlers:
    """Answers requests for torques."""

    def __init__(self, state: PlannerState) -> None:
        self._state = state

    def inverse_dynamics(self, request: InverseDynamicsRequest) -> InverseDynamics:
        """The torques of states of motion, with what the robot carries now. Raises InvalidRequest."""
        scene = self._state.scenes.present(self._state.settings.margin, openings=self._state.grippers.present())
        dynamics, position = scene.model.dynamics, self._rows(request.joints, "joints")
        if dynamics is None:
            return InverseDynamics()
        velocity, acceleration = (
            np.zeros_like(position) if given is None else self._rows(given, field)
            for field, given in (("velocity", request.velocity), ("acceleration", request.acceleration))
        )
        return InverseDynamics(
            torque=tuple(map(tuple, dynamics.torque(position, velocity, acceleration).tolist())),
            effort=tuple(effort if math.isfinite(effort) else None for effort in dynamics.limit.tolist()),
        )

    def _rows(self, rows: tuple[tuple[float, ...], ...], field: str) -> Array:
        return np.array([checked(self._state.model, row, f"{field}.{i}") for i, row in enumerate(rows)])
