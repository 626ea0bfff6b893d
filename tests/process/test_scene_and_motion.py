"""A plan belongs to its scene, and a goal to the scene it was begun in: planner and executor in their own processes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from support.command_line import Command, zarm
from support.executor.client import Client
from support.harness import PATIENCE, ServiceProcess, eventually
from support.planner.client import BEHIND_POST, HOME, POST, load, plan, to_joints
from support.tiers import sampled
from support.trajectories import KEYS
from zarm_contract.errors import ExecutionRefused
from zarm_contract.messages import Plan, PlanRequest
from zarm_runtime.bus import Bus

SLOWLY = 0.15
CHANGED = "the scene has changed since this motion was checked"


def way(bus: Bus, *, speed: float = 1.0) -> Plan:
    """A plan to behind where the post is to stand, straight through its place."""
    return plan(bus, PlanRequest(start=HOME, goal=to_joints(*BEHIND_POST), velocity_scale=speed))


def refused(client: Client, **asked: object) -> str:
    with pytest.raises(ExecutionRefused) as refusal:
        client.execute(**asked)  # type: ignore[arg-type]
    return refusal.value.code


def assert_stale(client: Client, made: Plan) -> None:
    """However it is asked for, the plan is refused, and the robot has not moved."""
    assert refused(client, plan_id=made.plan_id) == "stale_plan"
    assert refused(client) == "stale_plan"
    assert refused(client, trajectory=made.trajectory, scene_revision=made.scene_revision) == "stale_plan"
    assert client.stands()
    np.testing.assert_allclose(client.position(), HOME, atol=1e-6)
    assert client.goals == []


# --- plans ---


@pytest.mark.parametrize("edits", sampled(1, 0, 2))
def test_a_plan_from_before_the_scene_file_was_lost_is_stale(
    client: Client, endpoint: str, bus: Bus, tmp_path: Path, edits: int
) -> None:
    with ServiceProcess("planner", endpoint, tmp_path) as first:
        first.wait_ready(bus, KEYS)
        load(bus)
        made = way(bus)
    (tmp_path / KEYS.robot / "scene.json").unlink()
    with ServiceProcess("planner", endpoint, tmp_path) as second:
        second.wait_ready(bus, KEYS)
        for _ in range(edits):
            load(bus, POST)
        assert_stale(client, made)


@pytest.mark.slow
def test_a_plan_made_in_another_folder_for_state_is_stale(
    client: Client, endpoint: str, bus: Bus, tmp_path: Path
) -> None:
    with ServiceProcess("planner", endpoint, tmp_path) as first:
        first.wait_ready(bus, KEYS)
        load(bus)
        made = way(bus)
    other = tmp_path / "other"
    other.mkdir()
    with ServiceProcess("planner", endpoint, other) as second:
        second.wait_ready(bus, KEYS)
        load(bus, POST)
        assert_stale(client, made)


@pytest.mark.slow
def test_a_plan_is_stale_unless_its_own_scene_is_put_back(
    client: Client, endpoint: str, bus: Bus, tmp_path: Path
) -> None:
    file = tmp_path / KEYS.robot / "scene.json"
    with ServiceProcess("planner", endpoint, tmp_path) as first:
        first.wait_ready(bus, KEYS)
        load(bus)
        early, saved = way(bus), file.read_bytes()
        load(bus)
        late = way(bus)
    file.write_bytes(saved)
    with ServiceProcess("planner", endpoint, tmp_path) as second:
        second.wait_ready(bus, KEYS)
        assert refused(client, plan_id=late.plan_id) == "stale_plan"
        assert client.ended(client.execute(plan_id=early.plan_id)).status == "succeeded"
        back = PlanRequest(goal=to_joints(*HOME))
        assert client.ended(client.execute(plan_id=plan(bus, back).plan_id)).status == "succeeded"
        client.goals.clear()
        load(bus, POST)  # its second edit, as the one in which the late plan was made
        assert_stale(client, late)


# --- goals that are held ---


def held(client: Client, bus: Bus, *, by_trajectory: bool = False, speed: float = SLOWLY) -> str:
    """A goal that is on its way to behind the post's place, and held before it."""
    made = way(bus, speed=speed)
    goal = client.execute(made.trajectory) if by_trajectory else client.execute(plan_id=made.plan_id)
    client.under_way(goal, 0.1)
    client.command(KEYS.pause)
    client.mode("paused")
    return goal


@pytest.mark.parametrize("by_trajectory", sampled(False, True))
def test_a_held_goal_whose_scene_was_edited_does_not_resume(
    client: Client, endpoint: str, bus: Bus, tmp_path: Path, by_trajectory: bool
) -> None:
    with ServiceProcess("planner", endpoint, tmp_path) as planner:
        planner.wait_ready(bus, KEYS)
        load(bus)
        goal = held(client, bus, by_trajectory=by_trajectory)
        assert not client.state().scene_changed
        for objects in ((POST,), ()):  # taken out again it is still another scene
            load(bus, *objects)
            with pytest.raises(ExecutionRefused, match="cancel it, and plan again") as refusal:
                client.command(KEYS.resume)
            assert refusal.value.code == "stale_plan"
            assert client.stands()
            assert client.state().mode == "paused"
        client.cancel()
        assert client.ended(goal).status == "cancelled"
        new = plan(bus, PlanRequest(goal=to_joints(*BEHIND_POST)))
        assert client.ended(client.execute(plan_id=new.plan_id)).status == "succeeded"


def test_a_held_goal_in_the_same_scene_resumes_without_a_planner(
    client: Client, endpoint: str, bus: Bus, tmp_path: Path
) -> None:
    with ServiceProcess("planner", endpoint, tmp_path) as planner:
        planner.wait_ready(bus, KEYS)
        load(bus)
        goal = held(client, bus, speed=0.4)
        client.command(KEYS.resume)
        client.under_way(goal, 0.2)
        client.command(KEYS.pause)
        client.mode("paused")
        planner.kill()
    assert client.command(KEYS.resume).mode == "running"
    assert client.ended(goal).status == "succeeded"


# --- goals in motion ---


def test_a_scene_edit_under_a_moving_goal_is_reported(
    executor: ServiceProcess, client: Client, endpoint: str, bus: Bus, tmp_path: Path
) -> None:
    with ServiceProcess("planner", endpoint, tmp_path) as planner:
        planner.wait_ready(bus, KEYS)
        load(bus)
        made = way(bus, speed=SLOWLY)
        with Command("execute", "--plan-id", made.plan_id, folder=tmp_path, ZARM_CONNECT=endpoint) as command:
            eventually(lambda: client.goals and client.goals[-1].progress > 0.05, "the robot moves")
            assert not client.state().scene_changed
            load(bus, POST)
            eventually(lambda: client.state().scene_changed, "the state says so")
            assert CHANGED in zarm("status", ZARM_CONNECT=endpoint).stdout
            assert CHANGED in zarm("pause", ZARM_CONNECT=endpoint).stdout
            eventually(lambda: CHANGED in command.errors(), "the command that follows the goal says so")
            assert executor.output().count(CHANGED) == 1
            client.cancel()
            assert command.process.wait(PATIENCE) == 1
            assert command.errors().count(CHANGED) == 1
        assert not client.mode("idle").scene_changed
