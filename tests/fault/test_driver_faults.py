"""Whatever becomes of a robot's driver, the robot comes to rest, the executor says why, and nothing moves by itself."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import pytest
from driven import FAR, LIMIT, THERE, Driven, driven
from harness import eventually, free_endpoint
from motions import KEYS, rest_to_rest

from zarm_contract.bus import Bus
from zarm_contract.messages import DriverFault
from zarm_contract.session import open_router
from zarm_executor.machine import STALL_LIMIT

STREAMED, WHOLE = "joint_speed", "joint_trajectory"


@pytest.fixture(params=[STREAMED, WHOLE])
def robot(request: pytest.FixtureRequest, bus: Bus, endpoint: str, tmp_path: Path) -> Iterator[Driven]:
    with driven(bus, endpoint, tmp_path, request.param) as robot:
        yield robot
        assert robot.commanded_acceleration() <= LIMIT * 1.01


@pytest.fixture
def moving(robot: Driven) -> Driven:
    robot.client.under_way(robot.client.execute(THERE))
    return robot


def test_a_driver_that_stalls_in_motion_leads_to_a_fault(moving: Driven) -> None:
    moving.suffer(DriverFault(stall=True))
    moving.fault("tolerance_violated" if moving.strategy == STREAMED else "driver_stalled")
    stood = moving.at_rest()
    moving.suffer(DriverFault())
    np.testing.assert_allclose(moving.at_rest(), stood, atol=1e-3)
    moving.works_again()


def test_a_driver_that_falls_silent_leads_to_a_fault_and_has_stopped_when_it_is_heard_again(moving: Driven) -> None:
    moving.suffer(DriverFault(silent=True))
    moving.fault("driver_stalled")
    seen = len(moving.told)
    moving.suffer(DriverFault())
    eventually(lambda: len(moving.told) > seen, "the driver is heard")
    assert np.max(np.abs(moving.at_rest() - FAR)) > 0.05
    moving.works_again()


def test_joints_that_jump_lead_to_a_fault(moving: Driven) -> None:
    moving.suffer(DriverFault(jump=(0.5, 0.0, 0.0, 0.0, 0.0, 0.0)))
    state = moving.fault("tolerance_violated")
    assert state.problem.joint == "joint_1"
    moving.works_again()


def test_commands_that_get_lost_lead_to_a_fault(moving: Driven) -> None:
    moving.suffer(DriverFault(drop=1.0))
    if moving.strategy == WHOLE:  # it has everything already; what is lost is the stop
        moving.client.command(KEYS.stop)
        moving.fault("tolerance_violated")
        moving.suffer(DriverFault())  # now it is told again to stop
    else:
        moving.fault("tolerance_violated")
        moving.suffer(DriverFault())
    assert np.max(np.abs(moving.at_rest() - FAR)) > 0.05
    moving.works_again()


def test_a_driver_that_dies_leads_to_a_fault_and_a_new_one_does_not_move_by_itself(moving: Driven) -> None:
    moving.driver.kill()
    moving.fault("driver_stalled")
    at = [str(value) for value in moving.arm()]
    with moving.new_driver("--at", *at) as again:
        seen = len(moving.told)
        again.wait_ready(moving.bus, KEYS)
        eventually(lambda: len(moving.told) > seen, "the driver is heard")
        np.testing.assert_allclose(moving.at_rest(), np.array(at, dtype=float), atol=1e-9)
        moving.works_again()


def test_a_driver_that_plays_late_is_stopped(robot: Driven) -> None:
    robot.suffer(DriverFault(delay=1.5))
    robot.client.execute(THERE)
    robot.fault("tolerance_violated" if robot.strategy == STREAMED else "driver_stalled")
    robot.suffer(DriverFault())
    seen = len(robot.told)
    eventually(lambda: len(robot.told) > seen + 300, "what was under way, the stop last, has been played")
    assert np.max(np.abs(robot.at_rest() - FAR)) > 0.05
    robot.works_again()


def test_an_executor_killed_in_motion_comes_back_and_the_robot_rests_and_stays(moving: Driven) -> None:
    goal_id = moving.client.goals[-1].goal_id
    moving.executor.kill()
    if moving.strategy == STREAMED:  # the points run out; a whole trajectory is stopped by the executor that comes back
        moving.at_rest()
    with moving.new_executor() as again:
        again.wait_ready(moving.bus, KEYS)
        assert np.max(np.abs(moving.at_rest() - FAR)) > 0.01
        assert moving.client.goal(goal_id).status == "aborted"
        assert moving.client.state().mode == "idle"
        moving.works_again()


def test_an_executor_frozen_in_motion_leaves_the_robot_at_rest_and_is_in_fault_when_it_goes_on(moving: Driven) -> None:
    process = moving.executor.process
    os.kill(process.pid, signal.SIGSTOP)
    try:
        time.sleep(1.2 * STALL_LIMIT)  # how long it is frozen is what is tested
        if moving.strategy == STREAMED:
            moving.at_rest()  # without the executor: the points have run out; a whole trajectory is played on
    finally:
        os.kill(process.pid, signal.SIGCONT)
    moving.fault("driver_stalled")
    assert np.max(np.abs(moving.at_rest() - FAR)) > 0.01
    moving.works_again()


@pytest.mark.parametrize("robot", [STREAMED], indirect=True)
def test_some_lost_chunks_do_no_harm(robot: Driven) -> None:
    robot.suffer(DriverFault(drop=0.2))
    assert robot.client.ended(robot.client.execute(THERE)).status == "succeeded"
    np.testing.assert_allclose(robot.at_rest(), FAR, atol=0.005)


@pytest.mark.parametrize("strategy", [STREAMED, WHOLE])
def test_without_a_router_the_robot_comes_to_rest_and_stays_at_rest_when_it_is_back(
    tmp_path: Path, strategy: str
) -> None:
    endpoint = free_endpoint()
    with ExitStack() as stack:
        first = stack.enter_context(ExitStack())
        first.enter_context(open_router(endpoint))
        bus = stack.enter_context(Bus(endpoint))
        robot = stack.enter_context(driven(bus, endpoint, tmp_path, strategy))
        goal_id = robot.client.execute(rest_to_rest(FAR, slower=6.0))
        robot.client.under_way(goal_id, 0.1)
        first.close()
        eventually(lambda: "mode=fault" in robot.executor.output(), "the executor has noticed")
        assert "reason=driver_stalled" in robot.executor.output()
        stack.enter_context(open_router(endpoint))
        seen = len(robot.told)
        eventually(lambda: len(robot.told) > seen and not any(robot.told[-1].velocity), "the arm is told to stand")
        assert np.max(np.abs(robot.at_rest() - FAR)) > 0.05
        robot.fault("driver_stalled")
        robot.works_again()
