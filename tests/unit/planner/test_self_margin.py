"""The margin between a robot's own links is kept on the way, where the ends and the geometry allow it, and what is nearer is named."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from zarm_contract.errors import PlanningFailed
from zarm_contract.messages import JointGoal, PathConstraint
from zarm_contract.robot import load_robot
from zarm_geometry.collision import is_free
from zarm_geometry.exact import ExactScene
from zarm_geometry.robot_model import RobotModel
from zarm_geometry.world import World
from zarm_planner.context import PlanningContext
from zarm_planner.deadline import Deadline
from zarm_planner.pipeline import Verified, plan
from zarm_planner.planners.constrained import ConstrainedPlanner
from zarm_planner.planners.free import FreePlanner
from zarm_planner.scene.planning_scene import PlanningScene
from zarm_trajectory.arrays import Array
from zarm_trajectory.limits import Limits

MODEL = RobotModel.of(load_robot("ur5e"))
EMPTY = World((), 0.0)
SCENE = PlanningScene("1-000000000000", MODEL, EMPTY, ExactScene(MODEL, EMPTY))
MARGIN = 0.01
BETWEEN = 0.001
"""Metres by which what lies between two checked configurations may be nearer."""
FOLDED = 12
"""Problems between configurations in which two links are near to each other."""


@cache
def folded(least: float, most: float) -> tuple[Array, ...]:
    """Configurations, free in spheres, in which two links are as near to each other as this (m)."""
    random, found = np.random.default_rng(1), []
    while len(found) < 2 * FOLDED:
        q = random.uniform(np.maximum(MODEL.lower, -np.pi), np.minimum(MODEL.upper, np.pi))
        if is_free(MODEL, EMPTY, q) and least < SCENE.exact.nearest(q).distance < most:
            found.append(q)
    return tuple(found)


def motion(start: Array, goal: Array, self_margin: float) -> Verified:
    context = PlanningContext(SCENE.with_self_margin(self_margin), Limits.of(MODEL.robot), Deadline(60.0))
    return plan(FreePlanner(), context, start, JointGoal(kind="joints", position=tuple(goal.tolist())))


def test_motions_between_folded_configurations_keep_it() -> None:
    """And without it they come nearer."""
    roomy = MODEL.with_self_margin(MARGIN)
    ends = [q for q in folded(MARGIN, 4 * MARGIN) if is_free(roomy, EMPTY, q)]
    problems = list(zip(ends[::2], ends[1::2], strict=False))
    assert problems
    assert min(motion(*ends, 0.0).clearance for ends in problems) < MARGIN - BETWEEN
    for start, goal in problems:
        verified = motion(start, goal, MARGIN)
        assert verified.clearance > MARGIN - BETWEEN
        assert all(pair.distance > MARGIN - BETWEEN for pair in verified.too_near)


def test_a_goal_that_is_nearer_is_reached_and_said_to_be_nearer() -> None:
    near = folded(0.0, 0.8 * MARGIN)[0]
    verified = motion(np.array(MODEL.robot.descriptor.home), near, MARGIN)
    nearest = SCENE.exact.nearest(near)
    reported = {pair.pair: pair for pair in verified.too_near}[nearest.pair or ("", "")]
    assert np.allclose(verified.trajectory.position[-1], near, atol=1e-6)
    assert reported.distance == pytest.approx(verified.clearance, abs=1e-4)
    assert reported.distance <= nearest.distance + 1e-4
    assert reported.margin <= MARGIN
    assert 0.0 < reported.time <= verified.trajectory.duration + 1e-6


def test_no_margin_takes_more_than_its_share_of_what_is_free() -> None:
    """However large it is: links that are always near keep the distance that they have."""
    kept, q = MODEL.with_self_margin(0.2), np.random.default_rng(2).uniform(MODEL.lower, MODEL.upper, (2000, MODEL.dof))
    free = [x for x in q if is_free(MODEL, EMPTY, x)]
    assert sum(is_free(kept, EMPTY, x) for x in free) > (1.0 - 0.06 * len(MODEL.arrays.pairs)) * len(free)
    assert 0.0 < kept.arrays.apart.min() < 0.2


def test_who_is_refused_for_its_sake_is_told_to_lower_it() -> None:
    """With every component of the tip pose held, the arm cannot unfold first."""
    start = folded(0.001, MARGIN / 2)[0]
    held = PathConstraint(axes=(True,) * 6, position_tolerance=0.0005, angle_tolerance=0.001)
    scene = SCENE.with_self_margin(MARGIN)
    context = PlanningContext(scene, Limits.of(MODEL.robot), Deadline(60.0), path_constraint=held)
    goal = JointGoal(kind="joints", position=tuple(start.tolist()))
    with pytest.raises(PlanningFailed, match=r"no way out of the start, .* only \d\.\d mm .* lower self_margin"):
        plan(ConstrainedPlanner(), context, start, goal)
