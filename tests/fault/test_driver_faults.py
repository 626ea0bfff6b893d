"""What the table of faults has no line for: drivers that die or play late, and whole trajectories that somebody must stop."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import pytest

from support.executor.driven import FAR, LIMIT, THERE, Driven, driven
from support.harness import eventually, free_endpoint
from support.tiers import sampled
from support.trajectories import KEYS, rest_to_rest
from zarm_contract.messages import DriverFault
from zarm_runtime.bus import Bus
from zarm_runtime.session import open_router

STREAMED, WHOLE = "joint_speed", "joint_trajectory"


@pytest.fixture(params=sampled(STREAMED, WHOLE))
def robot(request: pytest.FixtureRequest, bus: Bus, endpoint: str, tmp_path: Path) -> Iterator[Driven]:
    """What is timed is the robot as it comes with zarm; other executors wait for joint states as a busy machine needs."""
    timed = request.node.get_closest_marker("timed") is not None
    with driven(bus, endpoint, tmp_path, request.param, waited_for=not timed) as robot:
        yield robot
        assert robot.commanded_acceleration() <= LIMIT * 1.01


@pytest.fixture
def moving(robot: Driven) -> Driven:
    robot.client.under_way(robot.client.execute(THERE))
    return robot


@pytest.mark.slow  # as one that falls silent, in test_fault_table.py, and whose joints come back, in unit/executor/test_silent_driver.py
@pytest.mark.timed
def test_a_dead_driver_is_a_fault_and_a_new_one_does_not_move(moving: Driven) -> None:
    moving.driver.kill()
    moving.fault("driver_stalled")
    at = [str(value) for value in moving.arm()]
    with moving.new_driver("--at", *at) as again:
        seen = len(moving.reported)
        again.wait_ready(moving.bus, KEYS)
        eventually(lambda: len(moving.reported) > seen, "the driver is heard")
        np.testing.assert_allclose(moving.at_rest(), np.array(at, dtype=float), atol=1e-9)
        moving.works_again()


@pytest.mark.slow
def test_a_driver_that_plays_late_is_stopped(robot: Driven) -> None:
    robot.set_fault(DriverFault(delay=1.5))
    robot.client.execute(THERE)
    robot.fault("tolerance_violated" if robot.strategy == STREAMED else "driver_stalled")
    robot.set_fault(DriverFault())
    seen = len(robot.reported)
    eventually(lambda: len(robot.reported) > seen + 300, "what was under way, the stop last, has been played")
    assert np.max(np.abs(robot.at_rest() - FAR)) > 0.05
    robot.works_again()


@pytest.mark.parametrize("robot", [WHOLE], indirect=True)
def test_a_restarted_executor_stops_the_driver_that_still_plays(robot: Driven) -> None:
    goal_id = robot.client.execute(rest_to_rest(FAR, slower=6.0))
    robot.client.under_way(goal_id, 0.1)
    robot.executor.kill()
    with robot.new_executor() as again:
        again.wait_ready(robot.bus, KEYS)
        assert np.max(np.abs(robot.at_rest() - FAR)) > 0.05
        assert robot.client.goal(goal_id).status == "aborted"
        robot.works_again()


@pytest.mark.parametrize("robot", [STREAMED], indirect=True)
def test_some_lost_chunks_do_no_harm(robot: Driven) -> None:
    robot.set_fault(DriverFault(drop=0.2))
    assert robot.client.ended(robot.client.execute(THERE)).status == "succeeded"
    np.testing.assert_allclose(robot.at_rest(), FAR, atol=0.005)


@pytest.mark.slow
def test_a_playing_driver_is_stopped_once_the_router_is_back(tmp_path: Path) -> None:
    endpoint = free_endpoint()
    with ExitStack() as stack:
        first = stack.enter_context(ExitStack())
        first.enter_context(open_router(endpoint))
        bus = stack.enter_context(Bus(endpoint))
        robot = stack.enter_context(driven(bus, endpoint, tmp_path, WHOLE))
        goal_id = robot.client.execute(rest_to_rest(FAR, slower=6.0))
        robot.client.under_way(goal_id, 0.1)
        first.close()
        eventually(lambda: "mode=fault" in robot.executor.output(), "the executor has noticed")
        assert "reason=driver_stalled" in robot.executor.output()
        stack.enter_context(open_router(endpoint))
        seen = len(robot.reported)
        eventually(
            lambda: len(robot.reported) > seen and not any(robot.reported[-1].velocity), "the arm is told to stand"
        )
        assert np.max(np.abs(robot.at_rest() - FAR)) > 0.05
        robot.fault("driver_stalled")
        robot.works_again()
