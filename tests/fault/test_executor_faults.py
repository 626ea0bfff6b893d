"""What a robot does when its executor is killed, frozen, told to end, shouted at, or cut off from the bus."""

from __future__ import annotations

import itertools
import os
import signal
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import pytest

from support.executor.client import Client, distance_from
from support.harness import PATIENCE, ServiceProcess, eventually, free_endpoint
from support.trajectories import HOME, KEYS, ROBOT, descriptor_at, moved, rest_to_rest
from zarm_contract.errors import Busy, Unavailable
from zarm_contract.messages import ExecuteRequest, ExecutorState, Nothing
from zarm_executor.machine import STALL_LIMIT
from zarm_runtime.bus import Bus
from zarm_runtime.session import open_router
from zarm_trajectory.follower import CATCH_UP
from zarm_trajectory.trajectory import TimedTrajectory

GIVEN_UP = 6.0
"""Seconds after which a client asks no longer, and the router has given up the link."""
SLOW = rest_to_rest(moved(1.5, -0.5), slower=2.0)
PATH = TimedTrajectory.of(SLOW, ROBOT.descriptor.joints)
SPEED = float(np.max(ROBOT.descriptor.cspace.velocity))


@pytest.mark.slow
def test_killed_in_motion_it_restarts_at_rest_goal_aborted(
    executor: ServiceProcess, client: Client, endpoint: str, tmp_path: Path
) -> None:
    goal_id = client.execute(SLOW)
    client.under_way(goal_id)
    executor.kill()
    was = np.array(client.measured[-1].position)
    with ServiceProcess("executor", endpoint, tmp_path) as again:
        again.wait_ready(client.bus, KEYS)
        now = client.position()
        assert client.stands()
        assert client.state().mode == "idle"
        assert np.max(np.abs(now - was)) < SPEED * 0.2
        assert np.max(np.abs(now - HOME)) > 0.05
        assert distance_from(PATH, now) < 1e-3
        left = client.goal(goal_id)
        assert left.status == "aborted"
        assert left.problem is not None
        assert left.problem.code == "unavailable"
        assert left.duration == pytest.approx(SLOW.duration)
        assert client.ended(client.execute(rest_to_rest(HOME, now))).status == "succeeded"
    with ServiceProcess("executor", endpoint, tmp_path) as once_more:
        once_more.wait_ready(client.bus, KEYS)
        with pytest.raises(Unavailable):
            client.goal(goal_id)


@pytest.mark.slow
def test_killed_at_rest_it_comes_back_exactly_where_it_stood(
    executor: ServiceProcess, client: Client, endpoint: str, tmp_path: Path
) -> None:
    goal_id = client.execute(rest_to_rest(moved(0.3)))
    client.ended(goal_id)
    rested = client.position()
    saved = tmp_path / KEYS.robot / "emulated_robot.json"
    eventually(lambda: str(rested[0]) in saved.read_text(), "the position is saved")
    executor.kill()
    with ServiceProcess("executor", endpoint, tmp_path) as again:
        again.wait_ready(client.bus, KEYS)
        np.testing.assert_array_equal(client.position(), rested)
        with pytest.raises(Unavailable):
            client.goal(goal_id)


def test_killed_it_restarts_no_faster_than_before(endpoint: str, bus: Bus, tmp_path: Path) -> None:
    slow = descriptor_at(100, tmp_path / "slow")
    slow.write_text(slow.read_text().replace("control_rate: 100", "control_rate: 100, speed_scale: 0.2"))
    for robot, reported, then in ((ROBOT.descriptor.name, 0.3, 0.3), (str(slow), 1.0, 0.2), (str(slow), None, 0.2)):
        with ServiceProcess("executor", endpoint, tmp_path, robot=robot) as process:
            process.wait_ready(bus, KEYS)
            if reported is not None:
                assert Client(bus).speed(reported) == reported
            process.kill()
        with ServiceProcess("executor", endpoint, tmp_path, robot=robot) as again:
            again.wait_ready(bus, KEYS)
            assert Client(bus).speed() == then


@pytest.mark.slow
def test_frozen_in_motion_it_stops_without_a_jump_in_fault(executor: ServiceProcess, client: Client) -> None:
    goal_id = client.execute(SLOW)
    client.under_way(goal_id)
    os.kill(executor.process.pid, signal.SIGSTOP)
    time.sleep(2 * STALL_LIMIT)  # how long it is frozen is what is tested
    os.kill(executor.process.pid, signal.SIGCONT)
    state = client.mode("fault")
    assert state.problem is not None
    assert state.problem.code == "driver_stalled"
    assert state.missed_ticks > 100
    end = client.goal(goal_id)
    assert end.status == "aborted"
    assert end.problem == state.problem
    assert client.stands()
    for before, after in itertools.pairwise(client.measured):
        jump = np.max(np.abs(np.subtract(after.position, before.position)))
        assert jump <= SPEED * min(after.stamp - before.stamp, CATCH_UP) * 1.01 + 1e-9
    stopped = client.position()
    assert distance_from(PATH, stopped) < 1e-3
    with pytest.raises(Unavailable, match="executor/reset"):
        client.execute(rest_to_rest(HOME, stopped))
    for _ in range(2):
        assert client.command(KEYS.reset).mode == "idle"
    assert client.ended(client.execute(rest_to_rest(HOME, stopped))).status == "succeeded"


@pytest.mark.slow
def test_frozen_at_rest_it_goes_on_as_if_nothing_had_been(executor: ServiceProcess, client: Client) -> None:
    os.kill(executor.process.pid, signal.SIGSTOP)
    time.sleep(2 * STALL_LIMIT)  # how long it is frozen is what is tested
    os.kill(executor.process.pid, signal.SIGCONT)
    assert client.ended(client.execute(rest_to_rest(moved(0.1)))).status == "succeeded"


@pytest.mark.slow
def test_a_request_that_expired_during_a_freeze_does_not_start(
    executor: ServiceProcess, client: Client, bus: Bus
) -> None:
    os.kill(executor.process.pid, signal.SIGSTOP)
    late = ExecuteRequest(trajectory=rest_to_rest(moved(0.1)), goal_id="late")
    with pytest.raises(Unavailable):
        bus.call(KEYS.execute, late, timeout=GIVEN_UP)
    os.kill(executor.process.pid, signal.SIGCONT)

    def executed() -> str | None:
        try:
            return client.execute(rest_to_rest(moved(-0.1)))
        except (Busy, Unavailable):
            return None

    assert client.ended(eventually(executed, "it executes again")).status == "succeeded"
    assert client.statuses("late") == []


@pytest.mark.slow
def test_a_resume_that_expired_during_a_freeze_moves_nothing(
    executor: ServiceProcess, client: Client, bus: Bus
) -> None:
    goal_id = client.execute(SLOW)
    client.under_way(goal_id)
    client.command(KEYS.pause)
    client.mode("paused")
    held = client.position()
    os.kill(executor.process.pid, signal.SIGSTOP)
    with pytest.raises(Unavailable):
        bus.call(KEYS.resume, Nothing(), timeout=GIVEN_UP)
    os.kill(executor.process.pid, signal.SIGCONT)
    seen = len(client.measured)
    eventually(lambda: len(client.measured) > seen + 50, "it tells its joints again")
    assert client.mode("paused").goal_id == goal_id
    np.testing.assert_allclose(client.position(), held, atol=1e-9)


def test_on_sigterm_in_motion_it_stops_first_and_exits_cleanly(
    executor: ServiceProcess, client: Client, endpoint: str, tmp_path: Path
) -> None:
    goal_id = client.execute(SLOW)
    client.under_way(goal_id)
    executor.process.terminate()
    assert executor.process.wait(PATIENCE) == 0
    eventually(lambda: client.goals[-1].done, "the goal's end has arrived")
    assert client.statuses(goal_id) == ["accepted", "running", "stopping", "cancelled"]
    assert client.goals[-1].problem is not None
    assert "told to end" in client.goals[-1].problem.message
    rested = np.array(client.measured[-1].position)
    assert not any(client.measured[-1].velocity)
    assert client.greatest_acceleration() <= 1.02
    assert distance_from(PATH, rested) < 1e-3
    with ServiceProcess("executor", endpoint, tmp_path) as again:
        again.wait_ready(client.bus, KEYS)
        np.testing.assert_array_equal(client.position(), rested)
        with pytest.raises(Unavailable):  # it is not reported as left running
            client.goal(goal_id)


@pytest.mark.slow
def test_a_storm_of_cancels_is_answered_and_stops_the_goal_once(client: Client) -> None:
    goal_id = client.execute(SLOW)
    client.under_way(goal_id)
    names = [goal_id if number % 2 else f"goal-{number}" for number in range(1000)]
    with ThreadPoolExecutor(50) as pool:
        answers = list(pool.map(client.cancel, names))
    assert len(answers) == 1000
    assert all(isinstance(answer, ExecutorState) for answer in answers)
    assert client.ended(goal_id).status == "cancelled"
    assert client.stands()
    assert client.greatest_acceleration() <= 1.02
    assert client.statuses(goal_id) == ["accepted", "running", "stopping", "cancelled"]


@pytest.mark.slow
def test_of_a_storm_of_requests_one_moves_the_robot(client: Client) -> None:
    slower = rest_to_rest(moved(1.5, -0.5), slower=10.0, dt=0.1)

    def attempt(_: int) -> str | None:
        try:
            return client.execute(slower)
        except Busy:
            return None

    with ThreadPoolExecutor(100) as pool:
        accepted = [goal_id for goal_id in pool.map(attempt, range(100)) if goal_id]
    assert len(accepted) == 1
    assert client.state().goal_id == accepted[0]
    client.command(KEYS.stop)
    assert client.ended(accepted[0]).status == "cancelled"
    assert {goal.goal_id for goal in client.goals} == set(accepted)
    assert client.greatest_acceleration() <= 1.02


@pytest.mark.slow
def test_without_a_router_the_motion_ends_and_is_visible_later(tmp_path: Path) -> None:
    endpoint = free_endpoint()
    with ExitStack() as stack:
        first = stack.enter_context(ExitStack())
        first.enter_context(open_router(endpoint))
        executor = stack.enter_context(ServiceProcess("executor", endpoint, tmp_path))
        client = Client(stack.enter_context(Bus(endpoint)))
        executor.wait_ready(client.bus, KEYS)
        goal_id = client.execute(SLOW)
        client.under_way(goal_id)
        first.close()
        eventually(lambda: "status=succeeded" in executor.output(), "the motion has ended")
        stack.enter_context(open_router(endpoint))

        def seen_again() -> bool:
            try:
                return client.goal(goal_id).status == "succeeded"
            except Unavailable:
                return False

        eventually(seen_again, "the goal is seen again")
        np.testing.assert_allclose(client.position(), moved(1.5, -0.5), atol=1e-9)
        assert client.ended(client.execute(rest_to_rest(moved(1.4, -0.5), moved(1.5, -0.5)))).status == "succeeded"


def test_of_two_executors_that_meet_the_younger_stops_and_ends(
    tmp_path: Path,
) -> None:
    endpoint = free_endpoint()
    with ExitStack() as stack:
        first = stack.enter_context(ExitStack())
        first.enter_context(open_router(endpoint))
        (tmp_path / "older").mkdir()
        (tmp_path / "younger").mkdir()
        older = stack.enter_context(ServiceProcess("executor", endpoint, tmp_path / "older"))
        client = Client(stack.enter_context(Bus(endpoint)))
        older.wait_ready(client.bus, KEYS)
        os.kill(older.process.pid, signal.SIGSTOP)  # so that it is not back before the other one has started
        first.close()
        stack.enter_context(open_router(endpoint))
        younger = stack.enter_context(ServiceProcess("executor", endpoint, tmp_path / "younger"))
        younger.wait_ready(client.bus, KEYS)
        goal_id = client.execute(SLOW)
        client.under_way(goal_id)
        os.kill(older.process.pid, signal.SIGCONT)
        assert younger.process.wait(PATIENCE) == 1
        assert "already on this bus" in younger.output()
        assert f"goal_id={goal_id} status=cancelled" in younger.output()
        older.wait_ready(client.bus, KEYS)
        assert older.process.poll() is None
        assert client.ended(client.execute(rest_to_rest(moved(0.1)))).status == "succeeded"
