"""The executor process as its clients meet it, over a real router."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from support.executor.client import Client, distance_from
from support.harness import PATIENCE, ServiceProcess, eventually
from support.tiers import sampled
from support.trajectories import HOME, KEYS, ROBOT, descriptor_at, moved, rest_to_rest
from zarm_contract.errors import Busy, Cancelled, InvalidRequest, Unavailable, ZarmError
from zarm_contract.key import Query
from zarm_contract.keys import Keys
from zarm_contract.messages import ExecuteRequest, ExecutorState, GoalState, SpeedRequest, Trajectory
from zarm_executor.reporter import FINISHED_GOALS
from zarm_executor.service import JOINT_STATES_PERIOD
from zarm_runtime.bus import Bus
from zarm_trajectory.trajectory import TimedTrajectory

FAR = rest_to_rest(moved(1.5, -0.5))
SHORT = rest_to_rest(moved(0.01))


# --- motion ---


def test_a_trajectory_is_followed_to_its_end(shared: Client) -> None:
    goal_id = shared.execute(FAR)
    end = shared.ended(goal_id)
    assert end.status == "succeeded"
    assert end.progress == 1.0
    assert end.problem is None
    np.testing.assert_allclose(shared.position(), moved(1.5, -0.5), atol=1e-9)
    assert shared.stands()
    assert shared.statuses(goal_id) == ["accepted", "running", "succeeded"]
    progress = [goal.progress for goal in shared.goals]
    assert progress == sorted(progress)
    assert len(set(progress)) > 5
    assert shared.greatest_acceleration() <= 1.02


def test_the_next_motion_starts_where_the_last_one_ended(shared: Client) -> None:
    shared.ended(shared.execute(SHORT))
    shared.ended(shared.execute(rest_to_rest(HOME, moved(0.01))))
    np.testing.assert_allclose(shared.position(), HOME, atol=1e-9)


def test_joints_are_published_at_100_hz_at_rest_too(shared: Client) -> None:
    shared.stands(100)
    stamps = np.array([joints.stamp for joints in shared.measured])
    np.testing.assert_allclose(np.diff(stamps) % 0.01, 0.005, atol=0.0051)
    assert np.median(np.diff(stamps)) == pytest.approx(0.01, abs=1e-4)
    assert shared.measured[-1].joint_names == ROBOT.descriptor.joints


@pytest.mark.slow
@pytest.mark.parametrize("rate", sampled(250, 125, 500))
def test_it_works_at_the_control_rate_of_the_descriptor(endpoint: str, bus: Bus, tmp_path: Path, rate: int) -> None:
    robot = str(descriptor_at(rate, tmp_path / "robot"))
    with ServiceProcess("executor", endpoint, tmp_path, robot=robot) as process:
        process.wait_ready(bus, KEYS)
        client = Client(bus)
        end = client.ended(client.execute(FAR))
        assert end.status == "succeeded"
        np.testing.assert_allclose(client.position(), moved(1.5, -0.5), atol=1e-9)
        assert client.greatest_acceleration() <= 1.02
        client.stands(100)
    stamps = np.array([joints.stamp for joints in client.measured])
    ticks = np.diff(stamps) * rate  # each in a tick of its own; some may be left out
    assert np.median(np.abs(ticks - np.rint(ticks))) < 0.1  # a busy machine has late ones
    assert ticks.min() > rate * JOINT_STATES_PERIOD - 0.5


@pytest.mark.parametrize("key", sampled(KEYS.cancel, KEYS.stop))
def test_cancel_and_stop_end_the_goal_at_rest_on_its_path(shared: Client, key: Query[Any, ExecutorState]) -> None:
    goal_id = shared.execute(FAR)
    shared.under_way(goal_id)
    assert shared.command(key).mode == "stopping"
    end = shared.ended(goal_id)
    assert end.status == "cancelled"
    assert end.problem is not None
    assert end.problem.code == "cancelled"
    assert shared.stands()
    np.testing.assert_allclose(shared.position(), end.joint_command, atol=1e-9)
    assert distance_from(TimedTrajectory.of(FAR, ROBOT.descriptor.joints), shared.position()) < 1e-3
    assert 0.3 < end.progress < 1.0
    assert shared.greatest_acceleration() <= 1.02
    assert shared.state().mode == "idle"


@pytest.mark.slow
def test_cancelling_what_does_not_run_changes_nothing(shared: Client) -> None:
    assert shared.cancel().mode == "idle"
    finished = shared.execute(SHORT)
    shared.ended(finished)
    running = shared.execute(rest_to_rest(moved(1.0), moved(0.01)))
    for goal_id in (finished, "goal-nobody"):
        assert shared.cancel(goal_id).mode == "running"
    assert shared.ended(running).status == "succeeded"
    assert shared.goal(finished).status == "succeeded"


@pytest.mark.slow
def test_a_paused_goal_is_held_until_it_is_resumed(shared: Client) -> None:
    goal_id = shared.execute(FAR)
    shared.under_way(goal_id)
    for _ in range(2):
        shared.command(KEYS.pause)
    shared.mode("paused")
    assert shared.goal(goal_id).status == "paused"
    assert shared.stands()
    for _ in range(2):
        assert shared.command(KEYS.resume).mode == "running"
    assert shared.ended(goal_id).status == "succeeded"
    assert shared.statuses(goal_id) == ["accepted", "running", "paused", "running", "succeeded"]
    np.testing.assert_allclose(shared.position(), moved(1.5, -0.5), atol=1e-9)
    assert shared.greatest_acceleration() <= 1.02


@pytest.mark.slow
def test_the_speed_is_read_changed_in_motion_published_and_stays(client: Client) -> None:
    published: list[float] = []
    client.bus.subscribe(KEYS.speed, lambda _, speed: published.append(speed.speed_scale))
    assert client.speed() == 1.0
    goal_id = client.execute(FAR)
    client.under_way(goal_id)
    assert client.speed(0.4) == 0.4
    assert client.state().speed_scale == 0.4
    end = client.ended(goal_id)
    assert end.status == "succeeded"
    assert end.duration < 0.8 * end.elapsed  # the duration is the planned one
    assert client.greatest_acceleration() <= 1.02
    assert client.speed() == 0.4
    eventually(lambda: published == [0.4], "the change was published")
    for wrong in (0.0, 0.01, 1.5):
        with pytest.raises(InvalidRequest) as refusal:
            client.bus.call(KEYS.speed, SpeedRequest.model_construct(speed_scale=wrong), timeout=10)
        assert refusal.value.problem.field == "speed_scale"


@pytest.mark.slow  # as in unit/executor/test_checks.py
def test_a_robot_beside_the_start_is_led_to_it_without_a_jump(shared: Client) -> None:
    shared.ended(shared.execute(rest_to_rest(moved(1.0, start=moved(0.04)), moved(0.04))))
    assert shared.greatest_acceleration() <= 1.02
    np.testing.assert_allclose(shared.position(), moved(1.04), atol=1e-9)


# --- refusals ---


def test_while_a_goal_runs_another_one_is_refused(shared: Client) -> None:
    goal_id = shared.execute(FAR)
    with pytest.raises(Busy, match=goal_id):
        shared.execute(SHORT)
    shared.command(KEYS.pause)
    with pytest.raises(Busy, match=goal_id):
        shared.execute(SHORT)
    shared.cancel()
    shared.ended(goal_id)


def renamed(trajectory: Trajectory) -> Trajectory:
    return trajectory.model_copy(update={"joint_names": ("a", *trajectory.joint_names[1:])})


@pytest.mark.parametrize(
    ("trajectory", "code", "names"),
    [
        (rest_to_rest(moved(1.0), slower=0.8), "limit_violated", "joint_1"),
        (rest_to_rest(moved(7.0)), "limit_violated", "joint_1"),
        (rest_to_rest(moved(0.5, 0.3), moved(0.0, 0.3)), "start_state_mismatch", "joint_2"),
        (renamed(SHORT), "invalid_request", "joint_names"),
    ],
    ids=["too fast", "out of range", "starts elsewhere", "other joints"],
)
def test_an_invalid_motion_is_refused_with_a_reason(
    shared: Client, trajectory: Trajectory, code: str, names: str
) -> None:
    with pytest.raises(ZarmError) as refusal:
        shared.execute(trajectory)
    assert refusal.value.code == code
    assert names in (refusal.value.problem.joint or refusal.value.problem.field or "")
    assert shared.stands()
    assert shared.state().mode == "idle"
    assert shared.goals == []


# --- strategies ---


@pytest.mark.slow
def test_a_switch_in_motion_brings_the_robot_to_rest_first(client: Client) -> None:
    published: list[str] = []
    client.bus.subscribe(KEYS.strategy, lambda _, strategies: published.append(strategies.active))
    assert client.strategy().active == "emulator"
    goal_id = client.execute(FAR)
    client.under_way(goal_id)
    assert client.strategy("ghost").active == "ghost"
    end = client.goal(goal_id)
    assert end.status == "cancelled"
    assert "switched" in end.problem.message
    assert client.stands()
    assert client.greatest_acceleration() <= 1.02
    rested = client.position()
    with pytest.raises(Unavailable, match="executor/strategy"):
        client.execute(SHORT)
    assert client.state().strategy == "ghost"
    assert client.strategy("emulator").active == "emulator"
    np.testing.assert_array_equal(client.position(), rested)
    client.ended(client.execute(rest_to_rest(HOME, rested)))
    np.testing.assert_allclose(client.position(), HOME, atol=1e-9)
    eventually(lambda: published == ["ghost", "emulator"], "each switch was published")


@pytest.mark.slow
def test_what_is_no_switch_leaves_the_goal_alone(shared: Client) -> None:
    goal_id = shared.execute(FAR)
    shared.under_way(goal_id, 0.1)
    assert shared.strategy("emulator").active == "emulator"
    with pytest.raises(InvalidRequest):
        shared.strategy("telepathy")
    assert shared.ended(goal_id).status == "succeeded"
    assert shared.statuses(goal_id) == ["accepted", "running", "succeeded"]


def test_an_unknown_strategy_is_refused_with_the_known_ones(shared: Client) -> None:
    with pytest.raises(InvalidRequest, match="emulator, ghost") as refusal:
        shared.strategy("telepathy")
    assert refusal.value.problem.field == "strategy"
    assert shared.strategy().active == "emulator"


def test_a_switch_that_fails_leaves_the_old_strategy_active(client: Client, tmp_path: Path) -> None:
    client.strategy("ghost")
    folder = tmp_path / KEYS.robot
    folder.rename(tmp_path / "aside")
    folder.write_text("a file where the folder should be")
    with pytest.raises(Unavailable, match="ghost is active again"):
        client.strategy("emulator")
    assert client.strategy().active == "ghost"
    folder.unlink()
    assert client.strategy("emulator").active == "emulator"
    assert client.ended(client.execute(SHORT)).status == "succeeded"


# --- what late joiners see, and who else is there ---


def test_a_late_joiner_sees_the_present_state_and_the_goals(shared: Client, place: str) -> None:
    first = shared.execute(SHORT)
    shared.ended(first)
    running = shared.execute(rest_to_rest(moved(1.5), moved(0.01)))
    with Bus(place) as late:
        seen: dict[str, GoalState] = {}
        late.watch(KEYS.goal("*"), lambda _, goal: seen.__setitem__(goal.goal_id, goal))
        assert seen[first].status == "succeeded"
        assert not seen[running].done
        assert Client(late).state().mode == "running"
        assert Client(late).strategy().active == "emulator"
        assert Client(late).ended(running).status == "succeeded"


@pytest.mark.slow
def test_the_last_finished_goals_are_kept_and_older_ones_dropped(shared: Client) -> None:
    goals = []
    for number in range(FINISHED_GOALS + 1):
        start, goal = (HOME, moved(0.001)) if number % 2 == 0 else (moved(0.001), HOME)
        goals.append(shared.execute(rest_to_rest(goal, start)))
        shared.ended(goals[-1])
    assert shared.goal(goals[1]).status == "succeeded"
    with pytest.raises(Unavailable):
        shared.goal(goals[0])


def test_a_second_executor_for_the_robot_does_not_start(
    executor: ServiceProcess, client: Client, endpoint: str, tmp_path: Path
) -> None:
    with ServiceProcess("executor", endpoint, tmp_path) as second:
        assert second.process.wait(PATIENCE) == 1
        assert "already on this bus" in second.output()
    assert client.ended(client.execute(SHORT)).status == "succeeded"


def test_a_second_robot_of_a_kind_moves_alone(shared: Client, place: str, tmp_path: Path) -> None:
    with ServiceProcess("executor", place, tmp_path, name="other") as second:
        second.wait_ready(shared.bus, Keys("other"))
        other = Client(shared.bus, Keys("other"))
        assert other.ended(other.execute(SHORT)).status == "succeeded"
        np.testing.assert_allclose(shared.position(), HOME, atol=1e-12)


def test_an_executor_that_cannot_start_says_why_in_one_line(endpoint: str, tmp_path: Path) -> None:
    with ServiceProcess("executor", endpoint, tmp_path, arguments=("--strategy", "telepathy")) as process:
        assert process.process.wait(PATIENCE) == 1
        assert "emulator, ghost" in process.output()
        assert "Traceback" not in process.output()


def test_an_executor_without_a_state_folder_does_not_start(endpoint: str, tmp_path: Path) -> None:
    (tmp_path / KEYS.robot).write_text("a file where the folder should be")
    with ServiceProcess("executor", endpoint, tmp_path) as process:
        assert process.process.wait(PATIENCE) == 1
        assert "--state" in process.output()
        assert "Traceback" not in process.output()


def test_a_goal_that_was_cancelled_before_it_came_does_not_start(shared: Client) -> None:
    request = ExecuteRequest(trajectory=rest_to_rest(moved(0.3)), goal_id="late.1")
    shared.cancel("late.1")
    with pytest.raises(Cancelled, match="before it started"):
        shared.bus.call(KEYS.execute, request, timeout=10)
    with pytest.raises(Cancelled, match="before it started"):
        shared.bus.call(KEYS.execute, request.model_copy(update={"preempt": True}), timeout=10)
    assert shared.stands()
    assert shared.state().mode == "idle"


def test_a_client_may_name_its_goal_once(shared: Client) -> None:
    there = rest_to_rest(moved(0.2))
    request = ExecuteRequest(trajectory=there, goal_id="mine.1")
    assert shared.bus.call(KEYS.execute, request, timeout=10).goal_id == "mine.1"
    assert shared.ended("mine.1").status == "succeeded"
    with pytest.raises(InvalidRequest, match="give every goal a new goal_id"):
        shared.bus.call(KEYS.execute, request, timeout=10)
