"""A joint that turns freely has no limits: planner, servo and executor start anywhere, and turn it the short way."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import ExitStack

import numpy as np
import pytest

import zarm
from support.harness import PATIENCE, ServiceProcess, router
from support.planner.small_arm import small_arm
from support.tiers import sampled
from zarm_contract.keys import Keys
from zarm_runtime.bus import Bus

TURN = 2 * math.pi
BEGIN = (15.0, 0.5, 1.0, 0.1)


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> Iterator[zarm.Robot]:
    """The small arm, whose first joint begins at 15 rad."""
    folder = tmp_path_factory.mktemp("continuous")
    descriptor = small_arm(folder).path
    descriptor.write_text(descriptor.read_text().replace("home: [0, 0.5, 1, 0.1]", "home: [15, 0.5, 1, 0.1]"))
    keys = Keys("small_arm")
    with router() as endpoint, Bus(endpoint) as bus, ExitStack() as stack:
        services = [
            stack.enter_context(ServiceProcess(service, endpoint, folder, str(descriptor)))
            for service in ("planner", "executor", "servo")
        ]
        for service in services:
            service.wait_ready(bus, keys)
        yield stack.enter_context(zarm.connect(endpoint))


@pytest.fixture(autouse=True)
def begun(robot: zarm.Robot) -> None:
    """The arm where it began, in an empty scene."""
    robot.scene.clear()
    robot.execute(robot.plan(BEGIN))
    assert robot.joint_state().position == pytest.approx(BEGIN, abs=1e-3)


@pytest.mark.parametrize(("way", "turns"), sampled((2.9, -3), (-3.0, 2), (-0.4, 2), (0.0, -3), (-3.0, 0)))
def test_a_continuous_joint_takes_the_short_way(robot: zarm.Robot, way: float, turns: int) -> None:
    plan = robot.plan((15.0 + way + turns * TURN, *BEGIN[1:]))
    turned = np.array(plan.trajectory.position)[:, 0]
    assert (turned[0], turned[-1]) == pytest.approx((15.0, 15.0 + way), abs=1e-3)
    assert np.abs(turned - 15.0).max() <= abs(way) + 1e-3
    assert robot.execute(plan).status == "succeeded"
    assert robot.joint_state().position[0] == pytest.approx(15.0 + way, abs=1e-3)


def test_a_pose_behind_half_a_turn_is_reached_the_short_way(robot: zarm.Robot) -> None:
    (there,) = robot.fk([(15.0 + 2.0 - 4 * TURN, *BEGIN[1:])])
    plan = robot.plan(zarm.Pose(there.position, there.orientation))
    turned = np.array(plan.trajectory.position)[:, 0]
    assert abs(turned[-1] - 15.0) <= math.pi + 1e-3
    robot.execute(plan)
    assert np.linalg.norm(np.subtract(robot.tip().position, there.position)) < 1e-3


def test_what_stands_in_the_short_way_is_passed_the_long_way(robot: zarm.Robot) -> None:
    tip = np.array(robot.tip().position)
    turned = -2.0
    across = np.array([math.cos(turned / 2), math.sin(turned / 2)])
    at = np.array([across[0] * tip[0] - across[1] * tip[1], across[1] * tip[0] + across[0] * tip[1]])
    robot.scene.add(zarm.Cylinder("wall", position=(*at.tolist(), 0.5), radius=0.08, length=2.0))
    plan = robot.plan((15.0 + turned, *BEGIN[1:]), max_attempts=4)
    assert robot.execute(plan).status == "succeeded"
    assert math.remainder(robot.joint_state().position[0] - 15.0 - turned, TURN) == pytest.approx(0.0, abs=1e-3)


def test_waypoints_and_a_path_constraint_turn_the_short_way_too(robot: zarm.Robot) -> None:
    through = [(15.0 + angle + TURN, *BEGIN[1:]) for angle in (0.5, 1.0, 1.5)]
    turned = np.array(robot.plan(zarm.Waypoints(*through)).trajectory.position)[:, 0]
    assert turned[-1] == pytest.approx(16.5, abs=1e-3)
    held = zarm.PathConstraint(("theta_x", "theta_y"))
    turned = np.array(robot.plan((15.0 + 0.8 - TURN, *BEGIN[1:]), path_constraint=held).trajectory.position)[:, 0]
    assert turned[-1] == pytest.approx(15.8, abs=1e-3)


def test_the_servo_turns_the_short_way(robot: zarm.Robot) -> None:
    with robot.track() as tracking:
        tracking.reach((15.0 + 0.5 - 2 * TURN, *BEGIN[1:]), timeout=PATIENCE)
    assert robot.joint_state().position[0] == pytest.approx(15.5, abs=0.005)


def test_a_plan_made_in_another_turn_is_executed_in_this_one(robot: zarm.Robot) -> None:
    wrapped = 15.0 - 2 * TURN
    plan = robot.plan((wrapped + 0.5, *BEGIN[1:]), start=(wrapped, *BEGIN[1:]))
    assert plan.trajectory.position[0][0] == pytest.approx(wrapped)
    robot.execute(plan)
    assert robot.joint_state().position[0] == pytest.approx(15.5, abs=1e-3)
