"""The trajectory of a goal is replaced, tick by tick without a thread."""

from __future__ import annotations

from pathlib import Path as Folder

import numpy as np
import pytest

from support.arrivals import arrival
from support.executor.bench import LIMIT, Bench
from support.executor.driver_bench import EVERY, Case, DriverBench
from support.trajectories import ROBOT, SCENE, moved, rest_to_rest
from zarm_contract.errors import Busy, ExecutionRefused
from zarm_contract.messages import Authority, Obstruction, PathConstraint
from zarm_executor.goal import Goal, Joined
from zarm_executor.monitor import Monitor
from zarm_trajectory.follower import TICK
from zarm_trajectory.trajectory import TimedTrajectory

ELSEWHERE = np.array(moved(-0.2))
BOX = Obstruction(object="box", link="link_5", time=1.0)


@pytest.fixture
def bench() -> Bench:
    bench = Bench()
    bench.machine.scene = SCENE
    return bench


def from_state(state: np.ndarray, duration: float = 4.0) -> TimedTrajectory:
    """From a state (3, J) to rest elsewhere."""
    position, velocity, acceleration = np.zeros((3, 2, len(ELSEWHERE)))
    position[:] = state[0], ELSEWHERE
    velocity[0], acceleration[0] = state[1], state[2]
    return TimedTrajectory(np.array([0.0, duration]), position, velocity, acceleration)


def blocked(bench: Bench, until: float, trajectory: int = 1) -> None:
    said = Authority(
        servo="servo",
        sequence=trajectory,
        goal_id="goal-1",
        trajectory=trajectory,
        scene_revision=SCENE,
        until=until,
        obstruction=BOX,
    )
    bench.machine.receive(said, bench.now)


@pytest.mark.parametrize("speed", [1.0, 0.4])
def test_the_robot_changes_trajectory_without_a_jump(bench: Bench, speed: float) -> None:
    bench.machine.set_speed(speed)
    trajectory = bench.execute(scene=SCENE)
    bench.run(0.3 / speed)
    at = bench.arm.follower.time + 0.1
    bench.machine.replace("goal-1", 1, from_state(trajectory.at(at)), SCENE, at, ())
    bench.run(6.0 / speed)
    ended = bench.machine.changes[-1]
    assert (ended.goal_id, ended.status) == ("goal-1", "succeeded")
    assert not any(change.hold for change in bench.machine.changes)
    np.testing.assert_allclose(bench.positions[-1], ELSEWHERE, atol=1e-9)
    acceleration = np.diff(bench.positions, n=2, axis=0) / TICK**2
    assert (np.abs(acceleration) / LIMIT).max() < 1.02


@pytest.mark.lengthy
@pytest.mark.parametrize("case", [Case("joint_speed"), Case("joint_pose", "position", EVERY)], ids=str)
def test_a_driver_that_is_streamed_to_goes_over_without_a_jump(case: Case, tmp_path: Folder) -> None:
    bench = DriverBench(case, tmp_path)
    bench.machine.scene = SCENE
    trajectory = bench.execute(np.array(moved(0.8)))
    bench.run(0.5)
    goal = bench.machine.goal_state()
    assert goal is not None
    at = goal.progress * trajectory.duration + 0.3
    bench.machine.replace("goal", 1, from_state(trajectory.at(at)), SCENE, at, ())
    bench.until("idle")
    assert bench.last().status == "succeeded"
    assert not any(change.hold for change in bench.machine.changes)
    np.testing.assert_allclose(bench.positions[-1], ELSEWHERE, atol=0.01)
    assert bench.commanded_acceleration() < 1.1 * LIMIT.max()


def test_a_braking_goal_goes_on_along_its_new_trajectory(bench: Bench) -> None:
    trajectory = bench.execute(scene=SCENE)
    bench.run(0.4)
    at = bench.arm.follower.time + 0.1
    blocked(bench, at + 0.02)
    bench.run(0.02)
    goal = bench.machine.goal_state()
    assert goal is not None
    assert goal.hold is not None
    bench.machine.replace("goal-1", 1, from_state(trajectory.at(at)), SCENE, at, ())
    bench.run(6.0)
    assert bench.machine.changes[-1].status == "succeeded"


def test_a_new_trajectory_is_followed_as_far_as_it_was_checked(bench: Bench) -> None:
    trajectory = bench.execute(scene=SCENE)
    bench.run(0.3)
    at = bench.arm.follower.time + 0.1
    bench.machine.replace("goal-1", 1, from_state(trajectory.at(at)), SCENE, at, (), until=1.0)
    bench.run(4.0)
    goal = bench.machine.goal_state()
    assert goal is not None
    assert goal.hold is not None
    assert bench.arm.follower.settled
    assert bench.arm.follower.time < at + 1.0
    free = Authority(servo="servo", sequence=1, goal_id="goal-1", trajectory=2, scene_revision=SCENE)
    bench.machine.receive(free, bench.now)
    bench.run(6.0)
    assert bench.machine.changes[-1].status == "succeeded"


def test_a_goal_waiting_at_rest_gets_a_trajectory_from_there(bench: Bench) -> None:
    trajectory = bench.execute(scene=SCENE)
    blocked(bench, 0.8)
    bench.run(2.0)
    rests = bench.arm.exact.position
    progress = bench.arm.follower.time
    fresh = from_state(np.stack((rests, np.zeros_like(rests), np.zeros_like(rests))))
    goal = bench.machine.replace("goal-1", 1, fresh, SCENE, Monitor(fresh, ROBOT.descriptor), ())
    assert (goal.number, goal.trajectory.begin) == (2, progress)
    bench.run(6.0)
    assert bench.machine.changes[-1].status == "succeeded"
    assert trajectory.duration != goal.trajectory.duration
    np.testing.assert_allclose(bench.positions[-1], ELSEWHERE, atol=1e-9)


def test_a_late_or_foreign_replacement_is_refused(
    bench: Bench,
) -> None:
    trajectory = bench.execute(scene=SCENE)
    bench.run(0.4)
    now = bench.arm.follower.time
    replace = bench.machine.replace
    with pytest.raises(ExecutionRefused, match="the robot is committed until"):
        replace("goal-1", 1, from_state(trajectory.at(now - 0.01)), SCENE, now - 0.01, ())
    with pytest.raises(ExecutionRefused, match="does not begin where"):
        replace("goal-1", 1, from_state(trajectory.at(now)), SCENE, now + 0.1, ())
    for goal_id, number in (("goal-1", 2), ("goal-0", 1)):
        with pytest.raises(ExecutionRefused, match="plan from the active one"):
            replace(goal_id, number, from_state(trajectory.at(now + 0.1)), SCENE, now + 0.1, ())
    with pytest.raises(Busy, match="is not waiting at rest"):
        replace("goal-1", 1, from_state(trajectory.at(now)), SCENE, Monitor(trajectory, ROBOT.descriptor), ())
    bench.run(trajectory.duration + 1.0)
    assert bench.machine.changes[-1].status == "succeeded"
    np.testing.assert_allclose(bench.positions[-1], trajectory.end, atol=1e-9)


@pytest.mark.parametrize("command", ["cancel", "pause"])
def test_an_ending_or_paused_goal_keeps_its_trajectory(bench: Bench, command: str) -> None:
    trajectory = bench.execute(scene=SCENE)
    bench.run(0.4)
    at = bench.arm.follower.time + 0.05
    if command == "cancel":
        bench.machine.cancel(None, "by a test", arrival())
    else:
        bench.machine.pause(arrival())
    with pytest.raises(Busy, match="is ending or pausing"):
        bench.machine.replace("goal-1", 1, from_state(trajectory.at(at)), SCENE, at, ())


@pytest.mark.parametrize("keeps", [None, PathConstraint(axes=(True, True, False, False, False, False))])
def test_a_joined_goal_is_replanned_only_if_it_holds_nothing(
    keeps: PathConstraint | None,
) -> None:
    path = TimedTrajectory.of(rest_to_rest(moved(0.4)), ROBOT.descriptor.joints)
    goal = Goal("goal-1", None, path, Monitor(path, ROBOT.descriptor), replan=True)
    joined = goal.replaced(path, SCENE, (), joined=Joined(keeps))
    assert joined.replan == (keeps is None)
