from __future__ import annotations

import threading
from concurrent.futures import ThreadPoolExecutor
from typing import NoReturn

import pytest

from support.harness import PATIENCE
from support.trajectories import ROBOT, SCENE, moved, plan, rest_to_rest
from zarm_contract.errors import ExecutionRefused, InvalidRequest, Unavailable
from zarm_contract.messages import ExecuteRequest, Plan
from zarm_executor.plans import PLANS_KEPT, Chosen, Plans

TRAJECTORY = rest_to_rest(moved(0.1))


def unanswered() -> NoReturn:
    raise Unavailable("no planner")


@pytest.fixture
def plans() -> Plans:
    return Plans(ROBOT.hash, unanswered)


def test_an_empty_request_means_the_last_plan(plans: Plans) -> None:
    for name in ("a", "b", "a"):
        plans.add("", plan(name, TRAJECTORY))
    assert plans.chosen(ExecuteRequest()).plan_id == "a"


def test_before_the_first_plan_an_empty_request_is_refused(plans: Plans) -> None:
    with pytest.raises(InvalidRequest, match="planner/plan"):
        plans.chosen(ExecuteRequest())


@pytest.mark.lengthy
def test_the_last_plans_are_known_by_id_and_older_ones_dropped(plans: Plans) -> None:
    for number in range(PLANS_KEPT + 1):
        plans.add("", plan(f"plan-{number}", TRAJECTORY))
    assert plans.chosen(ExecuteRequest(plan_id="plan-1")).plan_id == "plan-1"
    with pytest.raises(InvalidRequest, match="plan-0") as refusal:
        plans.chosen(ExecuteRequest(plan_id="plan-0"))
    assert refusal.value.problem.field == "plan_id"


def test_the_planner_s_newest_plan_goes_before_those_published() -> None:
    plans = Plans(ROBOT.hash, lambda: plan("newest", TRAJECTORY))
    plans.add("", plan("published", TRAJECTORY))
    assert plans.chosen(ExecuteRequest()).plan_id == "newest"
    assert plans.chosen(ExecuteRequest(plan_id="newest")).plan_id == "newest"
    assert plans.chosen(ExecuteRequest(plan_id="published")).plan_id == "published"


def test_an_older_plan_s_publication_is_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    asked = threading.Event()

    def newest() -> Plan:
        asked.set()
        return plan("newest", TRAJECTORY)

    monkeypatch.setattr("zarm_executor.plans.PUBLICATION_PATIENCE", PATIENCE)
    plans = Plans(ROBOT.hash, newest)
    with ThreadPoolExecutor(1) as pool:
        chosen = pool.submit(plans.chosen, ExecuteRequest(plan_id="on-its-way"))
        assert asked.wait(PATIENCE)
        plans.add("", plan("on-its-way", TRAJECTORY))
        assert chosen.result(PATIENCE).plan_id == "on-its-way"


def test_a_plan_names_its_scene_and_a_trajectory_may(plans: Plans) -> None:
    plans.add("", plan("made", TRAJECTORY, revision=SCENE))
    assert plans.chosen(ExecuteRequest()) == Chosen("made", TRAJECTORY, SCENE)
    claimed = ExecuteRequest(trajectory=TRAJECTORY, scene_revision=SCENE)
    assert plans.chosen(claimed) == Chosen(None, TRAJECTORY, SCENE)
    assert plans.chosen(ExecuteRequest(trajectory=TRAJECTORY)) == Chosen(None, TRAJECTORY, None)


def test_a_plan_for_another_description_of_the_robot_is_stale(plans: Plans) -> None:
    plans.add("", plan("foreign", TRAJECTORY, robot_hash="0123456789abcdef"))
    with pytest.raises(ExecutionRefused, match="same descriptor") as refusal:
        plans.chosen(ExecuteRequest())
    assert refusal.value.problem.code == "stale_plan"
