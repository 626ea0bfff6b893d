"""Plans as the executor gets, checks and previews them; the test plays the planner."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from executor_client import Client
from harness import ServiceProcess, eventually
from motions import HOME, KEYS, ROBOT, moved, plan, rest_to_rest

from zarm_contract.bus import Bus
from zarm_contract.errors import (
    ExecutionRefused,
    InvalidRequest,
)
from zarm_contract.messages import (
    JointState,
    Nothing,
    Plan,
    SceneEdited,
    Trajectory,
)

SHORT = rest_to_rest(moved(0.01))


# --- plans and the scene ---


def test_plans_are_executed_by_id_or_as_the_last_one(client: Client) -> None:
    with pytest.raises(InvalidRequest, match="no plan"):
        client.execute()
    plans = client.bus.latched(KEYS.plans, Plan)
    plans.set(plan("first", rest_to_rest(moved(0.02))))
    plans.set(plan("second", SHORT))
    assert client.ended(client.execute(plan_id="second")).plan_id == "second"
    with pytest.raises(ExecutionRefused):  # it starts at home
        client.execute(rest_to_rest(moved(1.0), moved(0.5)))
    with pytest.raises(InvalidRequest, match="third"):
        client.execute(plan_id="third")
    client.ended(client.execute(rest_to_rest(HOME, moved(0.01))))
    assert client.ended(client.execute()).plan_id == "second"
    client.ended(client.execute(rest_to_rest(HOME, moved(0.01))))
    assert client.ended(client.execute(plan_id="first")).plan_id == "first"


def attempt(client: Client, plan_id: str) -> str | None:
    """Execute a plan that the executor may not have received yet."""
    try:
        return client.execute(plan_id=plan_id)
    except InvalidRequest:
        return None


def test_the_plan_that_the_planner_holds_runs_before_its_publication_arrives(
    endpoint: str, bus: Bus, tmp_path: Path
) -> None:
    held = [plan("first", rest_to_rest(moved(0.02)))]
    bus.serve(KEYS.plans, Nothing, lambda _: held[-1], readable=True)  # nothing is ever published
    with ServiceProcess("executor", endpoint, tmp_path) as process:
        process.wait_ready(bus, KEYS)
        client = Client(bus)
        held.append(plan("second", SHORT))
        assert client.ended(client.execute()).plan_id == "second"
        client.ended(client.execute(rest_to_rest(HOME, moved(0.01))))
        held.append(plan("third", SHORT))
        assert client.ended(client.execute(plan_id="third")).plan_id == "third"


def test_where_no_planner_answers_the_plan_published_last_runs(client: Client) -> None:
    plans = client.bus.publisher(KEYS.plans, Plan)
    plans.put(plan("first", rest_to_rest(moved(0.02))))
    plans.put(plan("second", SHORT))
    goal_id = eventually(lambda: attempt(client, "second"), "the executor knows the second plan")
    client.ended(goal_id)
    client.ended(client.execute(rest_to_rest(HOME, moved(0.01))))
    assert client.ended(client.execute()).plan_id == "second"


def test_a_plan_made_before_the_executor_started_can_be_executed(endpoint: str, bus: Bus, tmp_path: Path) -> None:
    bus.latched(KEYS.plans, Plan).set(plan("early", SHORT))
    with ServiceProcess("executor", endpoint, tmp_path) as process:
        process.wait_ready(bus, KEYS)
        client = Client(bus)
        assert client.ended(client.execute()).plan_id == "early"


def test_a_plan_older_than_the_scene_is_stale(endpoint: str, bus: Bus, tmp_path: Path) -> None:
    scene = bus.latched(KEYS.scene_revision, SceneEdited)
    scene.set(SceneEdited(revision=3, count=0))
    bus.latched(KEYS.plans, Plan).set(plan("made-in-3", SHORT, revision=3))
    with ServiceProcess("executor", endpoint, tmp_path) as process:
        process.wait_ready(bus, KEYS)
        client = Client(bus)
        with pytest.raises(ExecutionRefused) as refusal:
            client.execute(SHORT, scene_revision=2)
        assert refusal.value.code == "stale_plan"
        client.ended(client.execute())
        client.ended(client.execute(rest_to_rest(HOME, moved(0.01))))
        scene.set(SceneEdited(revision=4, count=1))
        with pytest.raises(ExecutionRefused) as refusal:
            client.execute()
        assert refusal.value.code == "stale_plan"
        assert client.stands()


# --- the ghost ---


@pytest.mark.parametrize("strategy", ["emulator", "ghost"])
def test_every_plan_is_previewed_whatever_the_strategy_and_the_robot_stays(
    endpoint: str, bus: Bus, tmp_path: Path, strategy: str
) -> None:
    with ServiceProcess("executor", endpoint, tmp_path, arguments=("--strategy", strategy)) as process:
        process.wait_ready(bus, KEYS)
        client = Client(bus)
        shown: list[Trajectory] = []
        previews: list[JointState] = []
        bus.subscribe(KEYS.preview_trajectory, Trajectory, lambda _, trajectory: shown.append(trajectory))
        bus.subscribe(KEYS.preview_joint_states, JointState, lambda _, joints: previews.append(joints))
        plans = bus.publisher(KEYS.plans, Plan)
        slow = rest_to_rest(moved(1.5), slower=10)

        def previewed() -> bool:
            return len(previews) > 5 and previews[-1].position[0] > previews[0].position[0]

        plans.put(plan("slow", slow))
        eventually(previewed, "the ghost moves")
        plans.put(plan("impossible", rest_to_rest(moved(1.0), slower=0.5)))
        plans.put(plan("newer", rest_to_rest(moved(0.0, -0.3))))

        def rests_at_the_end() -> bool:
            return bool(np.allclose(previews[-1].position, moved(0.0, -0.3), atol=1e-9))

        eventually(rests_at_the_end, "the ghost is at the end of the newer plan")
        seen = len(previews)
        eventually(lambda: len(previews) > seen + 10, "the ghost is still shown")
        assert rests_at_the_end()
        assert previews[-1].joint_names == ROBOT.descriptor.joints
        assert shown == [slow, rest_to_rest(moved(0.0, -0.3))]
        assert {joints.position for joints in client.measured} == {tuple(HOME.tolist())}
        assert client.goals == []
