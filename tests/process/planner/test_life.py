"""The planner over its life: what it publishes and keeps, how work in hand is ended, and how it ends itself."""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import psutil
import pytest
import zenoh

from support.harness import PATIENCE, ServiceProcess, eventually, nothing_compiled
from support.planner.client import (
    BEHIND_FENCE,
    BEHIND_POST,
    FENCE,
    HOME,
    KEYS,
    POST,
    SHELF,
    TABLE,
    assert_sound,
    load,
    plan,
    to_joints,
)
from zarm_contract.errors import Busy, Cancelled, DeadlineExceeded, Unavailable, ZarmError
from zarm_contract.keys import Keys
from zarm_contract.messages import (
    AddObjects,
    CancelPlan,
    ClearScene,
    Cylinder,
    EditBatch,
    Health,
    Nothing,
    Plan,
    PlanRequest,
    Scene,
    SceneEdit,
    SetPairCollision,
    WaypointsGoal,
)
from zarm_runtime.bus import Bus


def test_a_deadline_ends_a_search_that_finds_nothing(planner: Bus) -> None:
    load(planner, *FENCE)
    with pytest.raises(DeadlineExceeded, match=r"0\.3 s"):
        plan(planner, PlanRequest(start=HOME, goal=to_joints(*BEHIND_FENCE), timeout=0.3))


def endless(planner: Bus, request_id: str, answers: list[ZarmError]) -> threading.Thread:
    """Ask for what takes a minute in vain, in a thread of its own; its answer goes to `answers`."""

    def ask() -> None:
        with pytest.raises(ZarmError) as caught:
            plan(
                planner,
                PlanRequest(
                    start=HOME, goal=to_joints(*BEHIND_FENCE), timeout=60.0, max_attempts=1000, request_id=request_id
                ),
            )
        answers.append(caught.value)

    thread = threading.Thread(target=ask)
    thread.start()
    return thread


def cancel(bus: Bus, request_id: str) -> bool:
    return bus.call(KEYS.plan_cancel, CancelPlan(request_id=request_id), timeout=PATIENCE).was_running


@contextmanager
def computing(planner: Bus) -> Iterator[None]:
    """Leave the block when the planner has computed for a while since it began."""
    process = psutil.Process(planner.call(KEYS.health("planner"), Nothing(), timeout=PATIENCE).pid)
    before = process.cpu_times().user
    yield
    eventually(lambda: process.cpu_times().user > before + 0.3, "the planner computes")


def test_a_cancel_ends_the_planning_that_it_names(planner: Bus) -> None:
    load(planner, *FENCE)
    answers: list[ZarmError] = []
    with computing(planner):
        thread = endless(planner, "in-vain", answers)
    assert not cancel(planner, "something-else")
    assert cancel(planner, "in-vain")
    thread.join(PATIENCE)
    assert [type(answer) for answer in answers] == [Cancelled]
    assert not cancel(planner, "in-vain")


def test_a_cancel_ends_the_search_for_faster_motions_too(planner: Bus) -> None:
    load(planner, POST)
    through = (to_joints(*BEHIND_POST), to_joints(*HOME))
    request = PlanRequest(
        start=HOME,
        goal=WaypointsGoal(kind="waypoints", through=through),
        optimize_s=30.0,
        timeout=60.0,
        request_id="for-long",
    )
    answers: list[ZarmError] = []

    def ask() -> None:
        with pytest.raises(Cancelled) as caught:
            plan(planner, request)
        answers.append(caught.value)

    thread = threading.Thread(target=ask)
    with computing(planner):
        thread.start()
    assert cancel(planner, "for-long")
    thread.join(PATIENCE)
    assert len(answers) == 1


def test_a_cancel_that_comes_before_its_request_ends_it(planner: Bus) -> None:
    load(planner, *FENCE)
    assert not cancel(planner, "on-its-way")
    answers: list[ZarmError] = []
    endless(planner, "on-its-way", answers).join(PATIENCE)
    assert [type(answer) for answer in answers] == [Cancelled]


def test_waiting_requests_can_be_cancelled_and_are_bounded(planner: Bus) -> None:
    load(planner, *FENCE)
    answers: list[ZarmError] = []
    threads = [endless(planner, f"queued-{i}", answers) for i in range((os.cpu_count() or 1) + 20)]
    eventually(lambda: answers, "one request too many has been refused")
    eventually(
        lambda: (
            [cancel(planner, f"queued-{i}") for i in range(len(threads))] and not any(t.is_alive() for t in threads)
        ),
        "all others are cancelled",
    )
    assert {type(answer) for answer in answers} == {Busy, Cancelled}


def test_plans_are_published_and_the_last_one_is_latched(planner: Bus, place: str) -> None:
    load(planner)
    answer = plan(planner, PlanRequest(start=HOME, goal=to_joints(*BEHIND_POST)))
    with Bus(place) as late:
        seen: list[Plan] = []
        late.watch(KEYS.plans, lambda _, message: seen.append(message))
        assert eventually(lambda: seen, "the last plan is there") == [answer]
        second = plan(planner, PlanRequest(start=HOME, goal=to_joints(*HOME)))
        assert eventually(lambda: seen[1:], "the next plan arrives") == [second]


def test_the_scene_is_published_whole_and_by_object(planner: Bus, foreign: zenoh.Session) -> None:
    first = load(planner, TABLE, POST)
    scenes: list[Scene] = []
    planner.watch(KEYS.scene, lambda _, message: scenes.append(message))
    edit = SceneEdit(edit=AddObjects(op="add", objects=(SHELF,)))
    edited = planner.call(KEYS.scene_edit, edit, timeout=PATIENCE)
    assert edited.revision != first.revision
    assert edited.count == 3
    eventually(lambda: len(scenes) > 1, "the edit is published")
    assert scenes == [
        Scene(revision=first.revision, objects=(TABLE, POST)),
        Scene(revision=edited.revision, objects=(TABLE, POST, SHELF)),
    ]
    singly = {
        str(r.ok.key_expr): r.ok for r in foreign.get(KEYS.scene_object("*"), timeout=PATIENCE) if r.ok is not None
    }
    assert set(singly) == {KEYS.scene_object(name) for name in ("table", "post", "shelf")}
    post = singly[KEYS.scene_object("post")]
    assert Cylinder.model_validate_json(post.payload.to_bytes()) == POST
    assert str(post.encoding).endswith("zarm.Cylinder.v4")
    planner.call(KEYS.scene_edit, SceneEdit(edit=ClearScene(op="clear")), timeout=PATIENCE)
    assert list(foreign.get(KEYS.scene_object("*"), timeout=PATIENCE)) == []


def test_an_object_that_may_be_touched_comes_after_its_scene(planner: Bus, foreign: zenoh.Session) -> None:
    """By itself it counts in every collision, and a robot that may touch it would be held."""
    load(planner)
    keys: list[str] = []
    with foreign.declare_subscriber(f"{KEYS.scene}/**", lambda sample: keys.append(str(sample.key_expr))):
        touched = SetPairCollision(op="pairs", names=(("link_6", "shelf"),), enabled=False)
        batch = EditBatch(op="batch", edits=(AddObjects(op="add", objects=(SHELF, POST)), touched))
        planner.call(KEYS.scene_edit, SceneEdit(edit=batch), timeout=PATIENCE)
        expected = [KEYS.scene_object("post"), KEYS.scene, KEYS.scene_object("shelf")]
        eventually(
            lambda: [key for key in keys if key in expected] == expected, "all three are published, in this order"
        )


def test_a_plan_states_the_scene_revision_it_was_made_in(planner: Bus) -> None:
    request = PlanRequest(start=HOME, goal=to_joints(*BEHIND_POST))
    without = load(planner)
    assert plan(planner, request).scene_revision == without.revision
    with_post = load(planner, POST)
    answer = plan(planner, request)
    assert answer.scene_revision == with_post.revision
    assert_sound(answer, HOME, (POST,))


def test_the_scene_survives_a_crash(endpoint: str, bus: Bus, tmp_path: Path) -> None:
    with ServiceProcess("planner", endpoint, tmp_path) as first:
        first.wait_ready(bus, KEYS)
        edited = load(bus, TABLE, POST)
        first.kill()
    with Bus(endpoint) as fresh, ServiceProcess("planner", endpoint, tmp_path) as second:
        second.wait_ready(fresh, KEYS)
        scene = fresh.read(KEYS.scene, timeout=PATIENCE)
        assert scene == Scene(revision=edited.revision, objects=(TABLE, POST))


def test_an_unreadable_scene_stops_planning_until_edited(endpoint: str, bus: Bus, tmp_path: Path) -> None:
    folder = tmp_path / "doosan_m1013"
    folder.mkdir()
    (folder / "scene.json").write_text("no scene")
    request = PlanRequest(start=HOME, goal=to_joints(*BEHIND_POST))
    with ServiceProcess("planner", endpoint, tmp_path) as process:
        process.wait_ready(bus, KEYS)
        with pytest.raises(Unavailable, match=r"scene\.json\.broken"):
            plan(bus, request)
        revision = load(bus).revision
        assert plan(bus, request).scene_revision == revision
        assert "scene" in process.output()


def test_a_second_planner_of_one_robot_is_refused(planner: Bus, place: str, tmp_path: Path) -> None:
    with ServiceProcess("planner", place, tmp_path) as second:
        assert second.process.wait(PATIENCE) == 1
        assert "already on this bus" in second.output()
    with ServiceProcess("planner", place, tmp_path, name="twin") as twin:
        twin.wait_ready(planner, Keys("twin"))
        request = PlanRequest(start=HOME, goal=to_joints(*BEHIND_POST))
        assert planner.call(Keys("twin").plan, request, timeout=PATIENCE).robot == "twin"


def test_while_kernels_compile_health_answers_and_plans_wait(endpoint: str, bus: Bus, tmp_path: Path) -> None:
    with ServiceProcess("planner", endpoint, tmp_path, environment=nothing_compiled(tmp_path)) as process:

        def busy() -> Health | None:
            try:
                health = bus.call(KEYS.health("planner"), Nothing(), timeout=5)
            except Unavailable:
                return None
            return health if health.activity.startswith("loading") else None

        health = eventually(busy, "the planner says what it is busy with")
        assert not health.ready
        with pytest.raises(Unavailable, match="ask again when its health says ready"):
            plan(bus, PlanRequest(start=HOME, goal=to_joints(*BEHIND_POST)))
        process.kill()


def test_the_end_of_the_service_answers_what_is_in_hand(endpoint: str, bus: Bus, tmp_path: Path) -> None:
    with ServiceProcess("planner", endpoint, tmp_path) as process:
        process.wait_ready(bus, KEYS)
        load(bus, *FENCE)
        answers: list[ZarmError] = []
        threads = [endless(bus, f"last-{i}", answers) for i in range((os.cpu_count() or 1) + 20)]
        eventually(lambda: len(answers) == 4, "as many are in hand as it takes, and the four others are refused")
        process.process.terminate()
        for thread in threads:
            thread.join(PATIENCE)
        assert process.process.wait(PATIENCE) == 0
        assert {type(answer) for answer in answers} == {Busy, Unavailable}
        assert all("shutting down" in str(answer) for answer in answers if isinstance(answer, Unavailable))
