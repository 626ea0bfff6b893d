"""OMPL's RRTConnect and path simplification on zarm's own collision checks, compiled."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np
from ompl import base, geometric, util

from zarm_geometry.kernels.arrays import memory
from zarm_geometry.kernels.edge import path_free
from zarm_geometry.robot_model import RobotModel
from zarm_geometry.world import World
from zarm_trajectory.arrays import Array


@dataclass(frozen=True)
class Run:
    """CPU seconds of both stages, and the length (rad) of the resulting path."""

    search: float
    shortcut: float
    length: float


def quiet(seed: int) -> None:
    """Silence OMPL and make it sample the same in every process; it can be seeded only once."""
    util.noOutputHandler()
    util.RNG.setSeed(seed)


STEP = 0.02
"""Rad between checked states of an edge, if states are checked; links of these robots move by up to 2 cm in it."""


def plan(model: RobotModel, world: World, start: Array, goals: Array, timeout: float, *, edges: bool) -> Run | None:
    """The cost of `simplified`; None if it took longer than `timeout`."""
    if (found := _solved(model, world, start, goals, timeout, edges=edges)) is None:
        return None
    path, searched, shortened = found
    return Run(searched, shortened, float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum()))


def simplified(model: RobotModel, world: World, start: Array, goals: Array, timeout: float) -> Array | None:
    """The path (n, dof) of one search and its simplification, by checks of edges."""
    found = _solved(model, world, start, goals, timeout, edges=True)
    return None if found is None else found[0]


def _solved(
    model: RobotModel, world: World, start: Array, goals: Array, timeout: float, *, edges: bool
) -> tuple[Array, float, float] | None:
    """One search from `start` (dof,) to any of `goals` (n, dof) and the simplification of its path, (n, dof), and the
    CPU seconds of both; None if it took longer.

    With `edges` one call checks a whole edge, to zarm's resolution; otherwise OMPL checks its states one by one, as it
    does by default. All other parameters are OMPL's own.
    """
    space = base.RealVectorStateSpace(model.dof)
    bounds = base.RealVectorBounds(model.dof)
    for k in range(model.dof):
        bounds.setLow(k, float(model.lower[k]))
        bounds.setHigh(k, float(model.upper[k]))
    space.setBounds(bounds)
    information = base.SpaceInformation(space)
    checks = _Checks(model, world)
    information.setStateValidityChecker(_States(information, checks))
    if edges:
        information.setMotionValidator(_Edges(information, checks))
    else:
        information.setStateValidityCheckingResolution(STEP / space.getMaximumExtent())
    information.setup()
    problem = base.ProblemDefinition(information)
    problem.addStartState(_state(space, start))
    goal = base.GoalStates(information)
    for q in goals:
        goal.addState(_state(space, q))
    problem.setGoal(goal)
    planner = geometric.RRTConnect(information)
    planner.setProblemDefinition(problem)
    planner.setup()
    began = time.thread_time()
    planner.solve(timeout)
    searched = time.thread_time()
    if not problem.hasExactSolution():
        return None
    path = problem.getSolutionPath()
    simplifying = time.thread_time()
    geometric.PathSimplifier(information, goal).simplifyMax(path)
    shortened = time.thread_time() - simplifying
    rows = np.array([[state[k] for k in range(model.dof)] for state in path.getStates()])
    return rows, searched - began, shortened


class _Checks:
    """The two rows given to a check, and its working memory, allocated once."""

    def __init__(self, model: RobotModel, world: World) -> None:
        self._model, self._world = model, world
        self._dof = range(model.dof)
        self._memory = memory(model.arrays)
        self._rows = np.empty((2, model.dof), np.float32)
        self._row = self._rows[:1]

    def state(self, state: base.State) -> bool:
        self._row[0] = [state[k] for k in self._dof]
        return path_free(self._model.arrays, self._world.arrays, self._memory, self._row)

    def edge(self, a: base.State, b: base.State) -> bool:
        self._rows[0] = [a[k] for k in self._dof]
        self._rows[1] = [b[k] for k in self._dof]
        return path_free(self._model.arrays, self._world.arrays, self._memory, self._rows)


class _States(base.StateValidityChecker):
    def __init__(self, information: base.SpaceInformation, checks: _Checks) -> None:
        super().__init__(information)
        self._checks = checks

    def isValid(self, state: base.State) -> bool:  # noqa: N802
        return self._checks.state(state)


class _Edges(base.MotionValidator):
    def __init__(self, information: base.SpaceInformation, checks: _Checks) -> None:
        super().__init__(information)
        self._checks = checks

    def checkMotion(self, a: base.State, b: base.State) -> bool:  # noqa: N802
        return self._checks.edge(a, b)


def _state(space: base.StateSpace, q: Array) -> base.State:
    state = space.allocState()
    for k, value in enumerate(q.tolist()):
        state[k] = value
    return state
