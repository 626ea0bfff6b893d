from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from support.trajectories import HOME, ROBOT, moved, rest_to_rest
from zarm_contract.errors import ExecutionRefused, InvalidRequest
from zarm_contract.messages import Trajectory
from zarm_executor.checks import executable, startable
from zarm_executor.strategies.base import Measured
from zarm_trajectory.limits import LIMIT_TOLERANCE
from zarm_trajectory.trajectory import TimedTrajectory

NOW = 1000.0
STILL = np.zeros(6)
EXECUTION = ROBOT.descriptor.execution


def changed(trajectory: Trajectory, name: str, sample: int, joint: int, value: float) -> Trajectory:
    rows = [list(row) for row in getattr(trajectory, name)]
    rows[sample][joint] = value
    return trajectory.model_copy(update={name: tuple(tuple(row) for row in rows)})


def measured_at(position: np.ndarray, *, velocity: np.ndarray = STILL, age: float = 0.0) -> Measured:
    return Measured(position, velocity, NOW - age)


def start_from(measured: Measured | None, path: TimedTrajectory | None = None) -> TimedTrajectory:
    return startable(path or executable(rest_to_rest(moved(0.5)), ROBOT), measured, NOW, ROBOT)


# --- the motion itself ---


def test_a_motion_as_fast_as_the_limits_allow_is_executable() -> None:
    executable(rest_to_rest(moved(2.0, -1.0, 0.5)), ROBOT)
    executable(rest_to_rest(moved(2.0, -1.0, 0.5), dt=100.0), ROBOT)


@pytest.mark.parametrize("slower", [0.9, 0.98])
def test_a_motion_faster_than_a_joint_may_go_is_refused(slower: float) -> None:
    with pytest.raises(ExecutionRefused, match="joint_2") as refusal:
        executable(rest_to_rest(moved(0.0, 3.0), slower=slower), ROBOT)
    assert refusal.value.problem.code == "limit_violated"
    assert refusal.value.problem.joint == "joint_2"


def test_what_happens_between_the_samples_counts() -> None:
    trajectory = rest_to_rest(moved(0.0, 3.0), slower=0.9, dt=100.0)
    assert np.abs(np.array(trajectory.velocity)).max() == 0.0
    with pytest.raises(ExecutionRefused, match="reaches") as refusal:
        executable(trajectory, ROBOT)
    assert refusal.value.problem.code == "limit_violated"


@pytest.mark.lengthy
@given(
    distance=st.floats(-3.0, 3.0),
    start_velocity=st.floats(-0.5, 0.5),
    start_acceleration=st.floats(-1.0, 1.0),
    duration=st.floats(0.5, 5.0),
)
def test_the_verdict_agrees_with_looking_at_every_moment(
    distance: float, start_velocity: float, start_acceleration: float, duration: float
) -> None:
    rows = np.zeros((3, 4, 6))
    rows[0] = HOME
    rows[:, 2, 0] = HOME[0] + distance, start_velocity, start_acceleration
    rows[0, 3, 0] = HOME[0]
    trajectory = Trajectory(
        joint_names=ROBOT.descriptor.joints,
        time=(0.0, 0.5, 0.5 + duration, 1.0 + 2 * duration),
        position=tuple(map(tuple, rows[0].tolist())),
        velocity=tuple(map(tuple, rows[1].tolist())),
        acceleration=tuple(map(tuple, rows[2].tolist())),
    )
    path = TimedTrajectory.of(trajectory, ROBOT.descriptor.joints)
    moments = np.array([path.at(time)[:, 0] for time in np.linspace(0.0, path.duration, 3000)])
    limits = ROBOT.descriptor.cspace
    allowed = np.array([ROBOT.upper[0], limits.velocity[0] * LIMIT_TOLERANCE, limits.acceleration[0] * LIMIT_TOLERANCE])
    excess = float(np.max(np.abs(moments) / allowed))
    if excess > 1.0:
        with pytest.raises(ExecutionRefused):
            executable(trajectory, ROBOT)
    elif excess < 0.999:  # in between, looking 3000 times is too coarse to tell
        executable(trajectory, ROBOT)


def test_a_motion_that_leaves_the_range_of_a_joint_is_refused() -> None:
    outside = HOME.copy()
    outside[2] = ROBOT.upper[2] + 0.01
    with pytest.raises(ExecutionRefused, match="position of joint_3 reaches") as refusal:
        executable(rest_to_rest(outside), ROBOT)
    assert refusal.value.problem.field == "trajectory.position"


@pytest.mark.parametrize(("sample", "end"), [(0, "start"), (-1, "end")])
def test_a_motion_that_does_not_start_and_end_at_rest_is_refused(sample: int, end: str) -> None:
    with pytest.raises(InvalidRequest, match=f"joint_4 moves .* at the {end}"):
        executable(changed(rest_to_rest(moved(0.5)), "velocity", sample, 3, 0.1), ROBOT)


@pytest.mark.parametrize("name", ["position", "velocity", "acceleration"])
@pytest.mark.parametrize("value", [1e300, -1e300, 1e12])
def test_absurd_numbers_are_refused(name: str, value: float) -> None:
    with pytest.raises(ExecutionRefused, match="joint_1"):
        executable(changed(rest_to_rest(moved(0.5)), name, 20, 0, value), ROBOT)


# --- where the robot is ---


def test_a_robot_at_the_start_may_go() -> None:
    np.testing.assert_array_equal(start_from(measured_at(HOME)).start, HOME)


def test_without_a_measured_state_nothing_starts() -> None:
    with pytest.raises(ExecutionRefused, match="driver") as refusal:
        start_from(None)
    assert refusal.value.problem.code == "no_joint_state"


def test_an_old_measured_state_is_none() -> None:
    start_from(measured_at(HOME, age=EXECUTION.joint_state_timeout * 0.9))
    with pytest.raises(ExecutionRefused, match=r"0\.11 s ago") as refusal:
        start_from(measured_at(HOME, age=EXECUTION.joint_state_timeout * 1.1))
    assert refusal.value.problem.code == "no_joint_state"


def test_a_start_elsewhere_is_refused_with_joint_and_distance() -> None:
    with pytest.raises(ExecutionRefused, match=r"joint_2 .* 0\.0600 rad away") as refusal:
        start_from(measured_at(moved(0.0, 0.06)))
    assert refusal.value.problem.code == "start_state_mismatch"
    assert refusal.value.problem.joint == "joint_2"


def test_a_robot_that_moves_is_refused() -> None:
    with pytest.raises(ExecutionRefused, match="joint_1 still moves") as refusal:
        start_from(measured_at(HOME, velocity=moved(0.02) - HOME))
    assert refusal.value.problem.code == "start_state_mismatch"


def test_a_robot_within_the_tolerance_is_led_to_the_start_first() -> None:
    path = start_from(measured_at(moved(0.04)))
    np.testing.assert_array_equal(path.start, moved(0.04))
    np.testing.assert_array_equal(path.position[1], HOME)


def test_a_joint_a_whole_turn_away_moves_on_from_where_it_is() -> None:
    turned = moved(-math.tau)  # joint 1 turns +-2 pi: this is the same pose, at the end of its range
    path = start_from(measured_at(turned))
    np.testing.assert_allclose(path.start, turned, atol=1e-9)
    np.testing.assert_allclose(path.end, turned + moved(0.5) - HOME, atol=1e-9)


def test_a_start_a_whole_turn_away_is_refused_at_a_limit() -> None:
    path = executable(rest_to_rest(moved(-0.5)), ROBOT)
    with pytest.raises(ExecutionRefused, match="joint_1") as refusal:
        start_from(measured_at(moved(-math.tau)), path)
    assert refusal.value.problem.code == "start_state_mismatch"


def test_a_joint_that_slides_has_no_whole_turns() -> None:
    joints = {
        child: dataclasses.replace(joint, type="prismatic") if joint.name == "joint_1" else joint
        for child, joint in ROBOT.urdf.joint_of_child.items()
    }
    sliding = dataclasses.replace(ROBOT, urdf=dataclasses.replace(ROBOT.urdf, joint_of_child=joints))
    path = executable(rest_to_rest(moved(0.5)), sliding)
    with pytest.raises(ExecutionRefused, match="joint_1"):
        startable(path, measured_at(moved(-math.tau)), NOW, sliding)
