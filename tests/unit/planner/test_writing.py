"""A plan written by the planner is read as the same plan, whatever its numbers are."""

from __future__ import annotations

import json

import numpy as np
import pytest

from support.trajectories import HOME, ROBOT, moved
from zarm_contract.codec import decode, encode
from zarm_contract.messages import JointGoal, Plan, PlanRequest
from zarm_geometry.robot_model import RobotModel
from zarm_planner.handlers import Handlers
from zarm_planner.kernels.decimals import write_inner_rows
from zarm_planner.scene.store import SceneStore
from zarm_planner.timing.rounding import DECIMALS
from zarm_planner.writing import written
from zarm_trajectory.trajectory import TimedTrajectory

JOINTS = ROBOT.descriptor.joints


@pytest.fixture(scope="module")
def plan(tmp_path_factory: pytest.TempPathFactory) -> Plan:
    planner = Handlers(RobotModel.of(ROBOT), "arm", SceneStore(tmp_path_factory.mktemp("state")), lambda: HOME)
    goal = JointGoal(kind="joints", position=tuple((moved(0.7) + 1e-16).tolist()))
    return planner.plan(
        PlanRequest(goal=goal, start=tuple((HOME + np.pi / 1000).tolist()), optimize_s=0.0, timeout=60.0)
    )


def with_samples(plan: Plan, *rows: np.ndarray) -> Plan:
    samples = TimedTrajectory(np.arange(len(rows[0])) * 0.01, *rows)
    return plan.model_copy(update={"trajectory": samples.message(JOINTS)})


def test_it_is_read_as_it_was_made_and_so_are_both_ends_which_are_not_rounded(plan: Plan) -> None:
    payload = encode(written(plan))
    assert decode(Plan, payload) == decode(Plan, encode(plan))
    assert decode(Plan, payload).trajectory.position[0] == tuple((HOME + np.pi / 1000).tolist())
    assert all(len(text) for text in write_inner_rows(*samples_of(plan), DECIMALS))


def samples_of(plan: Plan) -> tuple[np.ndarray, ...]:
    return tuple(np.asarray(getattr(plan.trajectory, row)) for row in ("position", "velocity", "acceleration"))


def test_every_rounded_number_is_read_as_the_same_number() -> None:
    rng = np.random.default_rng(0)
    for decimals in range(1, 16):
        numbers = np.round(
            rng.normal(size=(400, 5)) * 10.0 ** rng.integers(-decimals - 1, 14 - decimals, (400, 5)), decimals
        )
        numbers[7] = 0.0, -0.0, 1.0, -10.0, 10.0**-decimals
        least = min(decimals, 9)
        (text, *_) = write_inner_rows(numbers, numbers, numbers, (least, least, least))
        rows = json.loads(b"[" + text.tobytes()[:-1] + b"]")
        np.testing.assert_array_equal(np.array(rows), numbers[1:-1])


@pytest.mark.parametrize("wild", [np.pi, 1e300, 5e-324, -1e16 / 3, np.nan, np.inf])
def test_rows_with_another_number_are_left_to_the_general_writer(plan: Plan, wild: float) -> None:
    position, velocity, acceleration = (rows.copy() for rows in samples_of(plan))
    velocity[5, 2] = wild
    texts = write_inner_rows(position, velocity, acceleration, DECIMALS)
    assert [len(text) > 0 for text in texts] == [True, False, True]
    if np.isfinite(wild):
        read = decode(Plan, encode(written(with_samples(plan, position, velocity, acceleration))))
        assert read.trajectory.velocity[5][2] == wild


def test_a_motion_of_two_samples_is_read_as_it_was_made(plan: Plan) -> None:
    read = decode(Plan, encode(written(with_samples(plan, *(rows[:2] for rows in samples_of(plan))))))
    assert read.trajectory.position == tuple(map(tuple, samples_of(plan)[0][:2].tolist()))
