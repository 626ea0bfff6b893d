"""Plans as the executor gets, checks and previews them; the test plays the planner."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from support.executor.client import Client
from support.harness import ServiceProcess, eventually
from support.tiers import sampled
from support.trajectories import HOME, KEYS, ROBOT, SCENE, moved, plan, rest_to_rest
from zarm_contract.errors import (
    ExecutionRefused,
    InvalidRequest,
    Unavailable,
)
from zarm_contract.key import Query
from zarm_contract.messages import (
    JointState,
    Nothing,
    Plan,
    SceneEdited,
    Trajectory,
)
from zarm_contract.roles import EVERYONE
from zarm_runtime.bus import Bus, LatchedPublisher

SHORT = rest_to_rest(moved(0.01))


ONLY_READ = Query("planner/plans", Nothing, Plan, "The last plan.", by=EVERYONE, readable=True).of_robot(KEYS.robot)


def tell_scene(bus: Bus, revision: str = SCENE) -> LatchedPublisher[SceneEdited]:
    """What the planner says of its scene; keep it."""
    scene = bus.latched(KEYS.scene_revision)
    scene.set(SceneEdited(revision=revision, count=0))
    return scene


# --- plans and the scene ---


def test_plans_are_executed_by_id_or_as_the_last_one(client: Client) -> None:
    with pytest.raises(InvalidRequest, match="no plan"):
        client.execute()
    tell_scene(client.bus)
    plans = client.bus.latched(KEYS.plans)
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


def test_a_plan_is_fetched_before_its_publication_arrives(endpoint: str, bus: Bus, tmp_path: Path) -> None:
    tell_scene(bus)
    held = [plan("first", rest_to_rest(moved(0.02)))]
    bus.serve(ONLY_READ, lambda _: held[-1])  # nothing is ever published
    with ServiceProcess("executor", endpoint, tmp_path) as process:
        process.wait_ready(bus, KEYS)
        client = Client(bus)
        held.append(plan("second", SHORT))
        assert client.ended(client.execute()).plan_id == "second"
        client.ended(client.execute(rest_to_rest(HOME, moved(0.01))))
        held.append(plan("third", SHORT))
        assert client.ended(client.execute(plan_id="third")).plan_id == "third"


def test_where_no_planner_answers_the_plan_published_last_runs(client: Client) -> None:
    scene = client.bus.publisher(KEYS.scene_revision)
    plans = client.bus.publisher(KEYS.plans)
    scene.put(SceneEdited(revision=SCENE, count=0))
    plans.put(plan("first", rest_to_rest(moved(0.02))))
    plans.put(plan("second", SHORT))
    goal_id = eventually(lambda: attempt(client, "second"), "the executor knows the second plan")
    client.ended(goal_id)
    client.ended(client.execute(rest_to_rest(HOME, moved(0.01))))
    assert client.ended(client.execute()).plan_id == "second"


def test_a_plan_made_before_the_executor_started_can_be_executed(endpoint: str, bus: Bus, tmp_path: Path) -> None:
    tell_scene(bus)
    bus.latched(KEYS.plans).set(plan("early", SHORT))
    with ServiceProcess("executor", endpoint, tmp_path) as process:
        process.wait_ready(bus, KEYS)
        client = Client(bus)
        assert client.ended(client.execute()).plan_id == "early"


def refused(client: Client, trajectory: Trajectory | None = None, scene_revision: str | None = None) -> str:
    with pytest.raises(ExecutionRefused) as refusal:
        client.execute(trajectory, scene_revision=scene_revision)
    return refusal.value.code


@pytest.mark.parametrize("other", sampled("4-5be0c1d2f3a4", "3-0123456789ab", "2-5be0c1d2f3a4"))
def test_a_plan_of_any_other_scene_than_the_present_one_is_stale(
    endpoint: str, bus: Bus, tmp_path: Path, other: str
) -> None:
    present = "3-5be0c1d2f3a4"
    scene = tell_scene(bus, present)
    bus.latched(KEYS.plans).set(plan("made-in-3", SHORT, revision=present))
    with ServiceProcess("executor", endpoint, tmp_path) as process:
        process.wait_ready(bus, KEYS)
        client = Client(bus)
        assert refused(client, SHORT, other) == "stale_plan"
        client.ended(client.execute())
        client.ended(client.execute(rest_to_rest(HOME, moved(0.01))))
        client.ended(client.execute(SHORT, scene_revision=present))
        client.ended(client.execute(rest_to_rest(HOME, moved(0.01))))
        scene.set(SceneEdited(revision=other, count=1))
        assert refused(client) == "stale_plan"
        assert refused(client, SHORT, present) == "stale_plan"
        assert client.stands()


def test_a_plan_of_an_unknown_scene_is_refused(client: Client) -> None:
    with pytest.raises(Unavailable, match="start the planner"):
        client.execute(SHORT, scene_revision=SCENE)
    assert client.stands()
    client.ended(client.execute(SHORT))  # its client answers for it


# --- the ghost ---


@pytest.mark.parametrize("strategy", sampled("emulator", "ghost"))
def test_every_plan_is_previewed_under_every_strategy(endpoint: str, bus: Bus, tmp_path: Path, strategy: str) -> None:
    with ServiceProcess("executor", endpoint, tmp_path, arguments=("--strategy", strategy)) as process:
        process.wait_ready(bus, KEYS)
        client = Client(bus)
        shown: list[Trajectory] = []
        previews: list[JointState] = []
        bus.subscribe(KEYS.preview_trajectory, lambda _, trajectory: shown.append(trajectory))
        bus.subscribe(KEYS.preview_joint_states, lambda _, joints: previews.append(joints))
        plans = bus.publisher(KEYS.plans)
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
