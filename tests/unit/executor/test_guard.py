"""A goal and its authority, tick by tick without a thread."""

from __future__ import annotations

import pytest

from support.arrivals import arrival
from support.executor.bench import Bench
from support.trajectories import ROBOT, SCENE
from zarm_contract.errors import ExecutionRefused
from zarm_contract.messages import Authority, Obstruction

SEQUENCE = iter(range(1, 10**6))
BOX = {"object": "box", "link": "link_5"}


def authority(
    until: float | None = None,
    *,
    goal_id: str | None = "goal-1",
    scene: str | None = SCENE,
    contact: float | None = None,
) -> Authority:
    found = None if until is None else Obstruction(**BOX, time=until + 0.1 if contact is None else contact)
    return Authority(
        servo="servo",
        sequence=next(SEQUENCE),
        goal_id=goal_id,
        scene_revision=scene,
        until=until,
        obstruction=found,
    )


def bench_with(**execution: object) -> Bench:
    descriptor = ROBOT.descriptor
    settings = descriptor.execution.model_copy(update=execution)
    bench = Bench(robot=descriptor.model_copy(update={"execution": settings}))
    bench.machine.scene = SCENE
    return bench


@pytest.fixture
def bench() -> Bench:
    return bench_with(obstruction_timeout=5.0)


def guarded_for(bench: Bench, seconds: float, said: Authority) -> None:
    """Turn the clock, and have the servo say the same every 0.1 s."""
    for _ in range(round(seconds / 0.1)):
        bench.machine.receive(said.model_copy(update={"sequence": next(SEQUENCE)}), bench.now)
        bench.run(0.1)


@pytest.mark.lengthy
@pytest.mark.parametrize("share", [0.3, 0.6, 0.9])
def test_it_rests_before_its_authority_ends_and_resumes(bench: Bench, share: float) -> None:
    trajectory = bench.execute(scene=SCENE)
    until = share * trajectory.duration
    guarded_for(bench, trajectory.duration + 1.0, authority(until))
    assert until - 0.1 < bench.arm.follower.time <= until
    assert bench.arm.follower.speed == 0.0
    assert bench.machine.state().mode == "running"
    assert bench.machine.state().guarded
    hold = bench.last().hold
    assert hold is not None
    assert hold.obstruction == Obstruction(**BOX, time=until + 0.1)
    bench.machine.receive(authority(), bench.now)
    bench.until("idle")
    assert bench.last().status == "succeeded"
    assert bench.last().hold is None
    assert bench.greatest_acceleration() <= 1.005


def test_an_object_too_late_to_avoid_is_reported_and_braked_for(bench: Bench) -> None:
    trajectory = bench.execute(scene=SCENE)
    bench.run(trajectory.duration / 2)
    now = bench.arm.follower.time
    guarded_for(bench, 2.0, authority(now + 0.02, contact=now + 0.05))
    hold = bench.last().hold
    assert hold is not None
    assert hold.obstruction is not None
    assert not hold.obstruction.avoidable
    assert bench.arm.follower.speed == 0.0
    assert bench.greatest_acceleration() <= 1.005


def test_a_goal_that_is_held_for_long_is_given_up(bench: Bench) -> None:
    trajectory = bench.execute(scene=SCENE)
    guarded_for(bench, trajectory.duration + 7.0, authority(trajectory.duration / 2))
    assert bench.machine.state().mode == "idle"
    assert bench.last().status == "aborted"
    assert bench.last().problem is not None
    assert "box is in the way of link_5" in bench.last().problem.message


def test_a_check_in_another_scene_holds_and_never_resumes(bench: Bench) -> None:
    trajectory = bench.execute(scene=SCENE)
    until, other = trajectory.duration / 2, "2-5be0c1d2f3a4"
    guarded_for(bench, trajectory.duration + 1.0, authority(until, scene=other))
    held_at = bench.arm.follower.time
    assert held_at <= until
    assert not bench.machine.state().guarded
    guarded_for(bench, 1.0, authority(scene=other))
    assert bench.arm.follower.time == held_at
    bench.machine.scene = other
    guarded_for(bench, 1.0, authority(scene=other))
    assert bench.arm.follower.time > held_at


def test_old_and_foreign_messages_change_nothing(bench: Bench) -> None:
    trajectory = bench.execute(scene=SCENE)
    old = authority(trajectory.duration / 4)
    bench.machine.receive(authority(), bench.now)
    bench.machine.receive(old, bench.now)
    bench.machine.receive(authority(trajectory.duration / 4, goal_id="goal-7"), bench.now)
    bench.until("idle")
    assert bench.last().status == "succeeded"


def test_a_required_guard_that_is_silent_brakes_the_robot() -> None:
    bench = bench_with(guard="required")
    trajectory = bench.execute(scene=SCENE)
    guarded_for(bench, 0.5, authority())
    bench.run(trajectory.duration)
    held_at = bench.arm.follower.time
    assert bench.arm.follower.speed == 0.0
    hold = bench.last().hold
    assert hold is not None
    assert hold.reason == "no_guard"
    guarded_for(bench, 0.5, authority())
    assert bench.arm.follower.time > held_at


def test_a_goal_resumes_in_another_scene_once_checked_there(bench: Bench) -> None:
    trajectory = bench.execute(scene=SCENE)
    bench.run(0.5)
    bench.machine.pause(arrival())
    bench.until("paused")
    other = bench.machine.scene = "2-5be0c1d2f3a4"
    with pytest.raises(ExecutionRefused, match="cancel it, and plan again"):
        bench.machine.resume(arrival(), other)
    now = bench.arm.follower.time
    bench.machine.receive(authority(now + 0.01, scene=other), bench.now)
    bench.machine.resume(arrival(), other)
    guarded_for(bench, 1.0, authority(now + 0.01, scene=other))
    assert bench.arm.follower.time == now
    assert bench.last().hold is not None
    guarded_for(bench, trajectory.duration + 1.0, authority(scene=other))
    assert bench.last().status == "succeeded"
