"""A goal is guarded: planner, executor and servo in their own processes, and things that are put in the robot's way."""

from __future__ import annotations

import time
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import pytest

from support.cell import Cell
from support.harness import eventually
from support.planner.client import BEHIND_POST, POST, load
from support.planner.second_opinion import link_pose
from support.trajectories import KEYS, ROBOT, moved, rest_to_rest
from zarm_contract.errors import Unavailable
from zarm_contract.messages import ObjectPose, Sphere


def test_the_guard_stops_before_an_obstacle_and_resumes(
    cell: Cell,
) -> None:
    goal = cell.way()
    assert cell.client.state().guarded
    load(cell.bus, POST)
    hold = cell.held(goal).hold
    assert hold is not None
    assert hold.reason == "obstruction"
    assert hold.obstruction is not None
    assert hold.obstruction.object == "post"
    assert hold.obstruction.avoidable
    cell.rests()
    state = cell.client.state()
    assert (state.mode, state.guarded, state.scene_changed) == ("running", True, False)
    cell.assert_free_of(POST)
    load(cell.bus)
    assert cell.client.ended(goal).status == "succeeded"
    np.testing.assert_allclose(cell.client.position(), BEHIND_POST, atol=1e-6)
    assert cell.client.greatest_acceleration() < 1.05


@pytest.mark.slow  # held it is above; that it is given up is in unit/executor/test_guard.py
def test_a_goal_blocked_for_long_is_aborted_with_the_obstacle(cell: Cell) -> None:
    goal = cell.way()
    load(cell.bus, POST)
    ended = cell.client.ended(goal)
    assert ended.status == "aborted"
    assert ended.problem is not None
    assert ended.problem.code == "stale_plan"
    assert "post is in the way of link" in ended.problem.message
    assert cell.client.state().mode == "idle"
    cell.assert_free_of(POST)


@pytest.mark.slow  # as in unit/executor/test_guard.py
def test_an_unavoidable_contact_is_braked_for_and_reported(cell: Cell) -> None:
    goal = cell.way(speed=1.0)
    cell.client.under_way(goal, 0.4)
    x, y, z = link_pose(ROBOT, ROBOT.descriptor.tip_link, cell.client.position())[:3, 3].tolist()
    load(cell.bus, Sphere(kind="sphere", name="hand", position=(x, y, z), radius=0.15))
    hold = cell.held(goal).hold
    assert hold is not None
    assert hold.obstruction is not None
    assert (hold.obstruction.object, hold.obstruction.avoidable) == ("hand", False)
    cell.rests()


@pytest.mark.slow
def test_a_goal_resumed_under_a_blocked_path_waits(cell: Cell) -> None:
    goal = cell.way()
    cell.client.command(KEYS.pause)
    cell.client.mode("paused")
    load(cell.bus, POST)
    assert cell.client.command(KEYS.resume).mode == "running"
    assert cell.held(goal).hold is not None
    cell.rests()
    cell.assert_free_of(POST)
    load(cell.bus)
    assert cell.client.ended(goal).status == "succeeded"


@pytest.mark.slow  # as in unit/servo/test_check.py and test_moving_objects.py
def test_the_guard_stops_for_a_moving_object_and_resumes(cell: Cell) -> None:
    away = POST.model_copy(update={"position": (-1.5, 0.0, 0.4)})
    goal = cell.way(away)
    poses = cell.bus.publisher(KEYS.object_pose("post"))

    def tell(position: tuple[float, float, float]) -> bool:
        poses.put(ObjectPose(stamp=time.time(), position=position, speed=0.1))
        return True

    eventually(lambda: tell(POST.position) and cell.client.goal(goal).hold is not None, "the goal is held")
    hold = cell.client.goal(goal).hold
    assert hold is not None
    assert hold.obstruction is not None
    assert hold.obstruction.object == "post"
    cell.rests()
    cell.assert_free_of(POST)
    servo = cell.bus.latest(KEYS.servo_state)

    def lost() -> bool:
        state = servo.get()
        return state is not None and state.lost_objects == ("post",)

    eventually(lost, "the post is lost")
    assert cell.client.goal(goal).hold is not None
    eventually(lambda: tell(away.position) and cell.client.goal(goal).done, "the goal has ended")
    assert cell.client.goal(goal).status == "succeeded"
    cell.bus.publisher(KEYS.object_pose("chair")).put(ObjectPose(stamp=time.time(), position=POST.position, speed=0.1))

    def refused() -> bool:
        state = servo.get()
        return state is not None and state.pose_refused is not None and state.pose_refused.field == "name"

    eventually(refused, "the pose of what is not there is refused")


@pytest.mark.slow  # most tests of the executor have no servo
def test_without_a_servo_a_robot_moves_on_as_unguarded(cell: Cell) -> None:
    goal = cell.way(speed=0.15)
    cell.services["servo"].kill()
    eventually(lambda: not cell.client.state().guarded, "the robot is unguarded")
    assert cell.client.ended(goal).status == "succeeded"
    cell.services["servo"] = cell.begin("servo")


def test_a_robot_that_must_be_guarded_moves_with_a_servo_alone(tmp_path: Path) -> None:
    with ExitStack() as stack:
        cell = Cell(stack, tmp_path, "guard: required", "executor")
        there = rest_to_rest(moved(0.8), slower=3.0)
        with pytest.raises(Unavailable, match="no servo gives this goal authority"):
            cell.client.execute(there)
        assert cell.client.stands()
        servo = cell.begin("servo")
        goal = cell.client.execute(there)
        cell.client.under_way(goal, 0.2)
        servo.kill()
        hold = cell.held(goal).hold
        assert hold is not None
        assert hold.reason == "no_guard"
        cell.rests()
        cell.begin("servo")
        assert cell.client.ended(goal).status == "succeeded"
        assert cell.client.greatest_acceleration() < 1.05
