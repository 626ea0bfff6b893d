"""What rounding a trajectory promises: the same motion in half as many characters, inside the same limits."""

from __future__ import annotations

import numpy as np
import pytest

from support.trajectories import HOME, ROBOT, curved_path, moved, rest_to_rest
from zarm_contract.codec import encode
from zarm_contract.messages import JointGoal
from zarm_geometry.exact import ExactScene
from zarm_geometry.robot_model import RobotModel
from zarm_geometry.world import World
from zarm_planner.context import PlanningContext
from zarm_planner.deadline import Deadline
from zarm_planner.kernels.rounding import round_samples
from zarm_planner.pipeline import plan
from zarm_planner.planners.free import FreePlanner
from zarm_planner.scene.planning_scene import PlanningScene
from zarm_planner.timing.rounding import rounded
from zarm_planner.timing.sampling import load
from zarm_planner.verification.verify import LOAD
from zarm_trajectory.limits import Limits
from zarm_trajectory.trajectory import TimedTrajectory

LIMITS = Limits.of(ROBOT)
JOINTS = ROBOT.descriptor.joints


def test_rounding_halves_the_message_within_limits() -> None:
    for seed in range(5):
        motion = curved_path(seed)
        short = rounded(motion, LIMITS)
        assert len(encode(short.message(JOINTS))) < 0.65 * len(encode(motion.message(JOINTS)))
        assert abs(load(short, LIMITS) - load(motion, LIMITS)) < 1e-4
        np.testing.assert_allclose(short.states[0], motion.states[0], rtol=0, atol=1e-8)
        assert np.array_equal(short.states[:, [0, -1]], motion.states[:, [0, -1]])


def test_dense_samples_keep_the_decimals_that_jerk_needs() -> None:
    motion = TimedTrajectory.of(rest_to_rest(moved(0.5)), JOINTS)
    times = np.sort(np.concatenate((motion.time, motion.time[5:40] + 1e-4)))
    dense = TimedTrajectory(times, *motion.sample(times))
    assert abs(load(rounded(dense, LIMITS), LIMITS) - load(dense, LIMITS)) < 1e-4


@pytest.mark.parametrize("scale", [0.1, 0.02, 0.01])
def test_slow_motions_are_not_refused_for_their_rounding(scale: float) -> None:
    """Where a hundredth of the acceleration is allowed, a hundredth of the rounding is."""
    model, world, limits = RobotModel.of(ROBOT), World((), 0.0), Limits.of(ROBOT, 1.0, scale)
    scene = PlanningScene("1-000000000000", model, world, ExactScene(model, world))
    goal = JointGoal(kind="joints", position=tuple(moved(0.5).tolist()))
    context = PlanningContext(scene, limits, Deadline(60.0), max_attempts=1)
    assert load(plan(FreePlanner(), context, HOME, goal).trajectory, limits) <= LOAD


def test_every_plan_is_rounded() -> None:
    model, world = RobotModel.of(ROBOT), World((), 0.0)
    scene = PlanningScene("1-000000000000", model, world, ExactScene(model, world))
    goal = JointGoal(kind="joints", position=tuple(moved(0.5).tolist()))
    found = plan(FreePlanner(), PlanningContext(scene, LIMITS, Deadline(5.0), seed=0), HOME, goal).trajectory
    np.testing.assert_array_equal(found.states, rounded(found, LIMITS).states)


def test_a_sample_is_the_nearest_multiple_of_its_decimal_unit() -> None:
    rng = np.random.default_rng(0)
    time = np.cumsum(10.0 ** rng.uniform(-4, -1, 60))
    states, units = rng.normal(size=(3, 60, 2)), 10.0 ** rng.uniform(-9, -1, (3, 2))
    found = np.stack(round_samples(time, *states, units, np.array((1e9, 1e7, 1e5))))
    assert np.array_equal(found[:, [0, -1]], states[:, [0, -1]])
    gap = np.minimum(np.diff(time)[:-1], np.diff(time)[1:])
    for row, (least, power) in enumerate(((9, 3), (7, 2), (5, 1))):
        for i, j in np.ndindex(58, 2):
            decimals = int(np.clip(np.ceil(-np.log10(units[row, j] * gap[i] ** power)), least, 15))
            assert found[row, i + 1, j] == round(states[row, i + 1, j], decimals)
