"""Two arms with an executor each, and a third executor that leads both: one motion, in step, and all stop if one does."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack

import numpy as np
import pytest

import zarm
from support.harness import PATIENCE, eventually
from support.led_cell import ARMS, LedCell
from zarm_contract.errors import Unavailable

DOWN = (1.0, 0.0, 0.0, 0.0)
ON_PATH = 1e-3
"""Rad: an arm this near to its part of a plan is on it."""


@pytest.fixture(scope="module")
def shared(tmp_path_factory: pytest.TempPathFactory) -> Iterator[LedCell]:
    with ExitStack() as stack:
        yield LedCell(stack, tmp_path_factory.mktemp("cell"))


@pytest.fixture
def cell(shared: LedCell) -> LedCell:
    """Both arms at home, by their common executor."""
    for name in ARMS:
        shared.clients[name].speed(1.0)
        shared.clients[name].reset()
    shared.whole.reset()
    eventually(lambda: all(shared.clients[name].state().mode == "idle" for name in ARMS), "the arms are free")
    shared.whole.execute(shared.whole.plan(shared.robot.descriptor.home))
    for seen in shared.seen.values():
        seen.clear()
    return shared


def slow(cell: LedCell) -> zarm.Plan:
    """A motion of both arms that takes a while."""
    goal = {"left": zarm.Pose((0.5, 0.45, 0.3), DOWN), "right": zarm.Pose((0.45, -0.5, 0.5), DOWN)}
    return cell.whole.plan(goal, velocity_scale=0.2, acceleration_scale=0.2)


def under_way(cell: LedCell, plan: zarm.Plan, share: float = 0.2) -> None:
    """Wait until the arms have gone this share of their way."""
    start, end = (np.array(plan.trajectory.position[k]) for k in (0, -1))
    eventually(
        lambda: np.abs(np.array(cell.whole.joint_state().position) - start).max() > share * np.abs(end - start).max(),
        "the arms are under way",
    )


def rest(cell: LedCell) -> None:
    """Wait until both arms have come to rest."""
    eventually(lambda: not any(any(cell.clients[name].joint_state().velocity) for name in ARMS), "the arms rest")


def assert_on_paths(cell: LedCell, plan: zarm.Plan) -> None:
    """Both arms were on their parts of the plan all along."""
    off = cell.off_path(plan)
    assert max(off.values()) < ON_PATH, off


def test_both_arms_follow_their_parts_of_one_motion(cell: LedCell) -> None:
    plan = slow(cell)
    cell.whole.execute(plan)
    for name in ARMS:
        measured = cell.clients[name].joint_state().position
        assert measured == pytest.approx(np.array(plan.trajectory.position[-1])[cell.part(name)], abs=ON_PATH)
    assert cell.whole.joint_state().position == pytest.approx(plan.trajectory.position[-1], abs=ON_PATH)
    assert_on_paths(cell, plan)


def test_a_pause_and_a_cancel_hold_for_both(cell: LedCell) -> None:
    plan = slow(cell)
    goal_id = cell.whole.start(plan)
    under_way(cell, plan)
    cell.whole.pause()
    rest(cell)
    cell.whole.resume()
    under_way(cell, plan, 0.6)
    cell.whole.cancel()
    assert cell.whole.follow(goal_id).status == "cancelled"
    rest(cell)
    assert_on_paths(cell, plan)


def test_if_one_arm_stops_the_other_comes_to_rest_on_its_path(cell: LedCell) -> None:
    plan = slow(cell)
    goal_id = cell.whole.start(plan)
    under_way(cell, plan)
    cell.clients["left_arm"].stop()
    ended = cell.whole.follow(goal_id)
    assert ended.status == "aborted"
    assert ended.problem is not None
    assert "left (the robot left_arm)" in ended.problem.message
    rest(cell)
    assert_on_paths(cell, plan)


def test_if_an_executor_ends_the_other_arm_stops_on_its_path(cell: LedCell) -> None:
    plan = slow(cell)
    goal_id = cell.whole.start(plan)
    under_way(cell, plan)
    with cell.killed("right_arm"):
        ended = cell.whole.follow(goal_id)
        assert ended.status == "aborted"
        eventually(lambda: not any(cell.clients["left_arm"].joint_state().velocity), "the left arm rests")
        assert cell.off_path(plan)["left_arm"] < ON_PATH


def test_nothing_moves_if_one_arm_could_not_follow(cell: LedCell) -> None:
    plan = slow(cell)
    cell.clients["right_arm"].speed(0.5)
    with pytest.raises(Unavailable, match=r"right \(the robot right_arm\) moves at 0.5 of its speed"):
        cell.whole.execute(plan)
    cell.clients["right_arm"].speed(1.0)
    assert cell.whole.joint_state().position == pytest.approx(cell.robot.descriptor.home, abs=ON_PATH)


def test_arms_in_real_time_are_not_led_faster(cell: LedCell) -> None:
    with cell.faster_leader() as leader:
        assert leader.process.wait(PATIENCE) != 0
        assert "left (the robot left_arm) runs in real time, and this executor faster" in leader.output()


def test_an_arm_that_is_not_led_moves_alone_and_is_waited_for(cell: LedCell) -> None:
    left = cell.clients["left_arm"]
    eventually(lambda: left.state().mode == "idle", "the arm is free")
    plan = slow(cell)
    home = list(cell.robot.descriptor.home[:7])
    way = zarm.Trajectory(
        tuple(f"panda_joint{i}" for i in range(1, 8)),
        [0.0, 2.0],
        [home, [home[0] + 0.2, *home[1:]]],
        np.zeros((2, 7)),
        np.zeros((2, 7)),
    )
    goal_id = left.start(way)
    with pytest.raises(Unavailable, match=f"left .* moves for {goal_id}"):
        cell.whole.execute(plan)
    assert left.follow(goal_id).status == "succeeded"
    eventually(lambda: abs(cell.whole.joint_state().position[0] - home[0] - 0.2) < ON_PATH, "the whole knows of it")


def test_one_arm_joins_in_while_the_other_is_led(cell: LedCell) -> None:
    first = cell.whole.plan(zarm.Pose((0.5, 0.45, 0.3), DOWN), group="left", velocity_scale=0.1, acceleration_scale=0.1)
    cell.whole.start(first)
    under_way(cell, first)
    cell.whole.execute_alongside(zarm.Pose((0.45, -0.5, 0.5), DOWN), group="right")
    assert cell.whole.tip("left").position == pytest.approx((0.5, 0.45, 0.3), abs=ON_PATH)
    assert cell.whole.tip("right").position == pytest.approx((0.45, -0.5, 0.5), abs=ON_PATH)
    assert cell.off_path(first)["left_arm"] < ON_PATH


def test_the_grippers_are_those_of_the_arms(cell: LedCell) -> None:
    cell.whole.gripper.move(0.03, gripper="right_hand")
    assert cell.clients["right_arm"].gripper.state("hand").width == pytest.approx(0.03, abs=1e-3)
    assert cell.clients["left_arm"].gripper.state("hand").width != pytest.approx(0.03, abs=1e-3)
    cell.whole.gripper.open("right_hand")
    assert cell.whole.gripper.state("right_hand").width == pytest.approx(0.08, abs=1e-3)
