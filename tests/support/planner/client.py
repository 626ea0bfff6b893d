"""Shared code of the tests of a running planner: its robot, places to go, and requests."""

from __future__ import annotations

import numpy as np

from support.harness import PATIENCE
from support.planner.second_opinion import Collisions
from support.trajectories import KEYS, ROBOT
from zarm_contract.messages import (
    Cuboid,
    Cylinder,
    JointGoal,
    LoadScene,
    Nothing,
    Plan,
    PlanRequest,
    SceneEdit,
    SceneEdited,
    SceneObject,
)
from zarm_executor.checks import executable
from zarm_runtime.bus import Bus

HOME = ROBOT.descriptor.home

TABLE = Cuboid(kind="cuboid", name="table", position=(0.6, 0.0, -0.1), size=(1.0, 1.6, 0.1))
POST = Cylinder(kind="cylinder", name="post", position=(0.38, 0.38, 0.4), radius=0.04, length=0.9)
SHELF = Cuboid(kind="cuboid", name="shelf", position=(0.2, 0.95, 0.75), size=(0.8, 0.3, 0.03))
BEHIND_POST = (1.6, 0.0, 1.570796, 0.0, 1.570796, 0.0)
"""Home turned: the straight way there passes through the post."""

LID = Cuboid(kind="cuboid", name="lid", position=(0.0, 0.0, 1.1), size=(6.0, 6.0, 0.05))
FENCE = (
    LID,
    *(
        Cylinder(kind="cylinder", name=f"bar_{i}", position=(-r / 2**0.5, r / 2**0.5, 0.3), radius=0.01, length=1.6)
        for i, r in enumerate(np.arange(0.34, 1.6, 0.11).tolist())
    ),
)
"""Bars in a half-plane, and a lid: from home no path leads half a turn around, and there is no short proof of it,
because the arm nearly fits between two bars.
"""
BEHIND_FENCE = (float(np.pi), *HOME[1:])


def load(bus: Bus, *objects: SceneObject) -> SceneEdited:
    return bus.call(KEYS.scene_edit, SceneEdit(edit=LoadScene(op="load", objects=objects)), timeout=PATIENCE)


def plan(bus: Bus, request: PlanRequest) -> Plan:
    return bus.call(KEYS.plan, request, timeout=PATIENCE)


def to_joints(*position: float) -> JointGoal:
    return JointGoal(kind="joints", position=position)


def is_alive(bus: Bus) -> bool:
    return bus.call(KEYS.health("planner"), Nothing(), timeout=PATIENCE).ready


def assert_sound(plan: Plan, start: tuple[float, ...], objects: tuple[SceneObject, ...]) -> np.ndarray:
    """The executor would accept the plan, and every centimetre of it is free; returns its end."""
    path = executable(plan.trajectory, ROBOT)
    assert np.allclose(path.start, start, atol=1e-6)
    assert np.all(np.diff(path.time) <= ROBOT.descriptor.interpolation_dt * 1.001)
    samples = np.array([path.at(t)[0] for t in np.linspace(0.0, path.duration, int(path.duration / 0.004) + 2)])
    assert np.abs(np.diff(samples, axis=0)).sum(axis=1).max() < 0.02
    collisions = Collisions(ROBOT, objects)
    assert not any(collisions.at(q) for q in samples)
    return path.end
