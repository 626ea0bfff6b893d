from __future__ import annotations

import numpy as np
import pytest

from support.trajectories import HOME, ROBOT, moved, rest_to_rest, rows
from zarm_contract.errors import InvalidRequest
from zarm_trajectory.trajectory import TimedTrajectory

JOINTS = ROBOT.descriptor.joints
VELOCITY = np.array(ROBOT.descriptor.cspace.velocity)
ACCELERATION = np.array(ROBOT.descriptor.cspace.acceleration)
JERK = np.array(ROBOT.descriptor.cspace.jerk)


def test_the_path_meets_every_sample() -> None:
    trajectory = rest_to_rest(moved(0.7, -0.3, 0.2))
    path = TimedTrajectory.of(trajectory, JOINTS)
    for index, time in enumerate(trajectory.time):
        expected = (trajectory.position[index], trajectory.velocity[index], trajectory.acceleration[index])
        np.testing.assert_allclose(path.at(time), expected, atol=1e-9)


def test_between_samples_the_path_is_the_quintic() -> None:
    ends = TimedTrajectory.of(rest_to_rest(moved(0.7, -0.3, 0.2), dt=100.0), JOINTS)  # first and last sample only
    samples = rest_to_rest(moved(0.7, -0.3, 0.2))
    assert len(ends.time) == 2
    for index, time in enumerate(samples.time):
        expected = (samples.position[index], samples.velocity[index], samples.acceleration[index])
        np.testing.assert_allclose(ends.at(time), expected, atol=1e-9)


def test_outside_its_time_the_path_is_at_its_end() -> None:
    path = TimedTrajectory.of(rest_to_rest(moved(0.5)), JOINTS)
    np.testing.assert_allclose(path.at(-1.0)[0], HOME, atol=1e-12)
    np.testing.assert_allclose(path.at(path.duration + 1.0)[0], moved(0.5), atol=1e-12)


def test_joints_may_come_in_any_order() -> None:
    trajectory = rest_to_rest(moved(0.1, 0.2, 0.3, 0.4))
    backwards = trajectory.model_copy(
        update={
            "joint_names": trajectory.joint_names[::-1],
            **{
                name: rows(np.array(getattr(trajectory, name))[:, ::-1])
                for name in ("position", "velocity", "acceleration")
            },
        }
    )
    np.testing.assert_array_equal(
        TimedTrajectory.of(backwards, JOINTS).position, TimedTrajectory.of(trajectory, JOINTS).position
    )


def test_a_few_times_are_sampled_as_all_are() -> None:
    path = TimedTrajectory.of(rest_to_rest(moved(0.7, -0.3, 0.2), dt=0.01), JOINTS)
    times = np.linspace(0.0, path.duration, 3 * len(path.time))
    every = path.sample(times)
    for index in range(0, len(times), 7):
        fresh = path.begun_at(0.0)
        np.testing.assert_allclose(fresh.sample(times[index : index + 1])[:, 0], every[:, index], atol=1e-9)
        np.testing.assert_allclose(fresh.at(times[index]), every[:, index], atol=1e-9)


def test_a_motion_is_read_from_the_message_that_it_wrote() -> None:
    path = TimedTrajectory.of(rest_to_rest(moved(0.7, -0.3, 0.2)), JOINTS)
    again = TimedTrajectory.of(path.message(JOINTS), JOINTS)
    np.testing.assert_array_equal(again.time, path.time)
    np.testing.assert_array_equal(again.states, path.states)


@pytest.mark.parametrize(
    "names",
    [(*JOINTS[:-1], "joint_7"), JOINTS[:-1] + JOINTS[:1]],
    ids=["a foreign joint", "a joint twice"],
)
def test_a_trajectory_of_other_joints_is_refused(names: tuple[str, ...]) -> None:
    trajectory = rest_to_rest(moved(0.1)).model_copy(update={"joint_names": names})
    with pytest.raises(InvalidRequest, match="needs each of joint_1") as refusal:
        TimedTrajectory.of(trajectory, JOINTS)
    assert refusal.value.problem.field == "trajectory.joint_names"


def test_samples_too_close_in_time_to_divide_by_are_refused() -> None:
    trajectory = rest_to_rest(moved(0.1), dt=100.0).model_copy(update={"time": (0.0, 5e-324)})
    with pytest.raises(InvalidRequest) as refusal:
        TimedTrajectory.of(trajectory, JOINTS)
    assert refusal.value.problem.field == "trajectory.time"


@pytest.mark.parametrize("jerk", [500.0, 10.0, 1.0])
@pytest.mark.parametrize("acceleration", [0.0, 1.0, -1.0], ids=["gently", "forwards at once", "backwards at once"])
def test_a_robot_beside_the_start_is_led_in_within_limits(jerk: float, acceleration: float) -> None:
    stands = moved(-0.04, 0.02)
    path = TimedTrajectory.of(rest_to_rest(moved(1.0)), JOINTS)
    path.acceleration[0] = acceleration * ACCELERATION
    whole = path.approached_from(stands, VELOCITY, ACCELERATION, np.full(6, jerk))
    lead = whole.duration - path.duration
    np.testing.assert_allclose(whole.at(0.0), (stands, np.zeros(6), np.zeros(6)), atol=1e-12)
    np.testing.assert_allclose(whole.at(lead)[0], HOME, atol=1e-9)
    np.testing.assert_allclose(whole.at(lead + 0.5), path.at(0.5), atol=1e-9)
    times = np.linspace(0.0, lead, 1000)
    _, velocity, bend = whole.sample(times)
    assert np.all(np.abs(velocity) <= VELOCITY * 1.0001)
    assert np.all(np.abs(bend) <= ACCELERATION * 1.0001)
    if acceleration == 0.0:
        assert np.max(np.abs(np.diff(bend, axis=0))) <= jerk * times[1] * 1.0001


def test_a_robot_at_the_start_is_led_nowhere() -> None:
    path = TimedTrajectory.of(rest_to_rest(moved(1.0)), JOINTS)
    assert path.approached_from(HOME, VELOCITY, ACCELERATION, JERK) is path
