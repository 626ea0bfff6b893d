"""Three robots of different kinds on one bus: each with a planner and an executor, and each answers for itself alone."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass

import numpy as np
import pytest

from support.executor.client import Client
from support.harness import PATIENCE, ServiceProcess, eventually, router
from support.trajectories import moved
from zarm_contract.keys import Keys
from zarm_contract.messages import JointGoal, PlanRequest
from zarm_contract.robot import RobotDescription, load_robot
from zarm_runtime.bus import Bus


@dataclass
class Arm:
    """One robot, and a client of it."""

    robot: RobotDescription
    keys: Keys
    client: Client

    @property
    def home(self) -> np.ndarray:
        return np.array(self.robot.descriptor.home)

    def start(self) -> str:
        """Plan a motion of 0.6 rad, slowly, and set out on it; the goal."""
        goal = JointGoal(kind="joints", position=tuple(moved(0.6, start=self.home)))
        request = PlanRequest(goal=goal, velocity_scale=0.2)
        plan = self.client.bus.call(self.keys.plan, request, timeout=PATIENCE)
        assert plan.robot_hash == self.robot.hash
        return self.client.execute(plan_id=plan.plan_id)


@pytest.fixture
def arms(tmp_path_factory: pytest.TempPathFactory) -> Iterator[list[Arm]]:
    """All at home."""
    with router() as endpoint, Bus(endpoint) as bus, ExitStack() as stack:
        found, services = [], []
        for name, kind in (("left", "doosan_m1013"), ("right", "doosan_m1013"), ("third", "ur5e")):
            keys, state = Keys(name), tmp_path_factory.mktemp(name)
            found.append(Arm(load_robot(kind), keys, Client(bus, keys)))
            for service in ("executor", "planner"):
                process = ServiceProcess(service, endpoint, state, kind, name)
                services.append((stack.enter_context(process), keys))
        for process, keys in services:
            process.wait_ready(bus, keys)
        yield found


@pytest.mark.slow
def test_each_moves_only_itself_and_a_cancel_stops_one_alone(arms: list[Arm]) -> None:
    left, right, third = arms
    goals = [(arm, arm.start()) for arm in (left, third)]
    for arm, goal_id in goals:
        arm.client.under_way(goal_id)
    assert right.client.stands()
    np.testing.assert_array_equal(right.client.position(), right.home)
    assert right.client.state().mode == "idle"

    goals.append((right, right.start()))
    right.client.under_way(goals[-1][1], 0.05)
    left.client.cancel()
    ends = [arm.client.ended(goal_id) for arm, goal_id in goals]
    assert [end.status for end in ends] == ["cancelled", "succeeded", "succeeded"]
    for arm in (right, third):
        np.testing.assert_allclose(arm.client.position(), moved(0.6, start=arm.home), atol=0.01)
    rested = left.client.position()
    assert left.home[0] < rested[0] < left.home[0] + 0.59
    assert left.client.stands()
    for arm, goal_id in goals:
        eventually(lambda arm=arm: any(goal.done for goal in arm.client.goals), "the end is told")
        assert {goal.goal_id for goal in arm.client.goals} == {goal_id}
