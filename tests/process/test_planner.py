"""The planner as its clients meet it: a process of its own, asked over a real router."""

from __future__ import annotations

import json
import os
import random
import re
import threading
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import zenoh
from harness import PATIENCE, ServiceProcess, eventually, router
from second_opinion import Collisions, link_pose, tip_error

from zarm_contract.bus import Bus
from zarm_contract.errors import Busy, Cancelled, DeadlineExceeded, ExecutionRefused, Problem, Unavailable, ZarmError
from zarm_contract.keys import Keys
from zarm_contract.messages import (
    AddObjects,
    CancelledPlan,
    CancelPlan,
    CheckRequest,
    CheckResults,
    ClearScene,
    Cuboid,
    Cylinder,
    FkPoses,
    FkRequest,
    Health,
    IkRequest,
    IkSolutions,
    JointGoal,
    JointState,
    LoadScene,
    Nothing,
    Plan,
    PlannerSettings,
    PlanRequest,
    Pose,
    PoseGoal,
    Scene,
    SceneEdit,
    SceneEdited,
    SceneObject,
    SettingsChange,
    Sphere,
)
from zarm_contract.robot import load_robot
from zarm_contract.session import open_client
from zarm_executor.checks import executable

ROBOT = load_robot("doosan_m1013")
KEYS = Keys("doosan_m1013")
HOME = ROBOT.descriptor.home

TABLE = Cuboid(kind="cuboid", name="table", position=(0.6, 0.0, -0.1), size=(1.0, 1.6, 0.1))
POST = Cylinder(kind="cylinder", name="post", position=(0.38, 0.38, 0.4), radius=0.04, length=0.9)
SHELF = Cuboid(kind="cuboid", name="shelf", position=(0.2, 0.95, 0.75), size=(0.8, 0.3, 0.03))
BEHIND_POST = (1.6, 0.0, 1.570796, 0.0, 1.570796, 0.0)
"""Home turned: the straight way there leads through the post."""

# Two half-planes and a lid around the robot's back: from home nothing leads half a turn around.
QUARTER = 0.375 * np.pi
WALL = Cuboid(
    kind="cuboid",
    name="wall",
    position=(-1.23, 1.23, 0.3),
    orientation=(0.0, 0.0, float(np.sin(QUARTER)), float(np.cos(QUARTER))),
    size=(3.0, 0.05, 1.6),
)
LID = Cuboid(kind="cuboid", name="lid", position=(0.0, 0.0, 1.1), size=(6.0, 6.0, 0.05))
BEHIND_WALL = (float(np.pi), *HOME[1:])


@pytest.fixture(scope="module")
def place() -> Iterator[str]:
    """The router of the planner that most tests share."""
    with router() as address:
        yield address


@pytest.fixture(scope="module")
def planner(place: str, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Bus]:
    """A session to a planner that is ready; each test gives it the scene it needs, and it must outlive them all."""
    with Bus(place) as bus, ServiceProcess("planner", place, tmp_path_factory.mktemp("planner")) as process:
        process.wait_ready(bus, KEYS)
        yield bus
        assert process.process.poll() is None


def load(bus: Bus, *objects: SceneObject) -> SceneEdited:
    return bus.call(
        KEYS.scene_edit, SceneEdit(edit=LoadScene(op="load", objects=objects)), SceneEdited, timeout=PATIENCE
    )


def plan(bus: Bus, request: PlanRequest) -> Plan:
    return bus.call(KEYS.plan, request, Plan, timeout=PATIENCE)


def to_joints(*position: float) -> JointGoal:
    return JointGoal(kind="joints", position=position)


def is_alive(bus: Bus) -> bool:
    return bus.call(KEYS.health("planner"), Nothing(), Health, timeout=PATIENCE).ready


def assert_sound(plan: Plan, start: tuple[float, ...], objects: tuple[SceneObject, ...]) -> np.ndarray:
    """The executor would take it, and every centimetre of it is free; returns where it ends."""
    path = executable(plan.trajectory, ROBOT)
    assert np.allclose(path.start, start, atol=1e-6)
    assert np.all(np.diff(path.time) <= ROBOT.descriptor.interpolation_dt * 1.001)
    samples = np.array([path.at(t)[0] for t in np.linspace(0.0, path.duration, int(path.duration / 0.004) + 2)])
    assert np.abs(np.diff(samples, axis=0)).sum(axis=1).max() < 0.02
    collisions = Collisions(ROBOT, objects)
    assert not any(collisions.at(q) for q in samples)
    return path.end


def test_a_joint_goal_behind_an_obstacle_is_reached_around_it(planner: Bus) -> None:
    objects = (TABLE, POST, SHELF)
    revision = load(planner, *objects).revision
    assert any(map(Collisions(ROBOT, objects).at, np.linspace(HOME, BEHIND_POST, 100)))
    answer = plan(planner, PlanRequest(start=HOME, goal=to_joints(*BEHIND_POST)))
    assert np.allclose(assert_sound(answer, HOME, objects), BEHIND_POST, atol=1e-6)
    assert answer.scene_revision == revision
    assert answer.robot == "doosan_m1013"
    assert answer.robot_hash == ROBOT.hash
    assert 0.0 < answer.clearance < 0.1
    assert answer.timings.total >= answer.timings.search + answer.timings.verify > 0.0


def test_a_pose_goal_is_reached_to_a_tenth_of_a_millimetre(planner: Bus) -> None:
    objects = (TABLE, POST, SHELF)
    load(planner, *objects)
    goal = PoseGoal(kind="pose", position=(0.3, 0.6, 0.3), orientation=(1.0, 0.0, 0.0, 0.0))
    answer = plan(planner, PlanRequest(start=HOME, goal=goal))
    end = assert_sound(answer, HOME, objects)
    distance, angle = tip_error(ROBOT, end, goal.position, goal.orientation)
    assert distance < 1e-4
    assert angle < 1e-4
    assert np.allclose(answer.tip.position, goal.position, atol=1e-4)


def test_the_same_request_gives_the_same_motion_and_another_seed_a_motion_too(planner: Bus) -> None:
    load(planner, TABLE, POST, SHELF)
    request = PlanRequest(start=HOME, goal=to_joints(*BEHIND_POST), seed=7)
    first, again = plan(planner, request), plan(planner, request)
    assert first.trajectory == again.trajectory
    assert first.plan_id != again.plan_id
    assert (
        plan(planner, request.model_copy(update={"seed": 8})).trajectory.position[-1] == first.trajectory.position[-1]
    )


def test_scales_make_the_motion_slower(planner: Bus) -> None:
    load(planner)
    goal = to_joints(1.0, *HOME[1:])
    full = plan(planner, PlanRequest(start=HOME, goal=goal))
    slow = plan(planner, PlanRequest(start=HOME, goal=goal, velocity_scale=0.25, acceleration_scale=0.25))
    fastest = np.abs(slow.trajectory.velocity).max(axis=0)
    assert np.all(fastest <= 0.25 * np.array(ROBOT.descriptor.cspace.velocity) * 1.002)
    assert slow.trajectory.duration > 1.9 * full.trajectory.duration


def test_a_robot_that_is_there_already_gets_a_motion_that_stands_still(planner: Bus) -> None:
    load(planner)
    answer = plan(planner, PlanRequest(start=HOME, goal=to_joints(*HOME)))
    assert set(answer.trajectory.position) == {HOME}
    assert answer.path_length == 0.0


def test_a_robot_close_to_a_surface_can_leave_it(planner: Bus) -> None:
    """The spheres that the search works with stand out of the links; what touches nothing exactly must not be stuck."""
    low = (0.0, 0.5, 1.8, 0.0, 0.8, 0.0)
    load(planner)
    free = planner.call(KEYS.check, CheckRequest(joints=(low,)), CheckResults, timeout=PATIENCE).results[0]
    assert not free.in_collision
    flange = link_pose(ROBOT, "link_6", low)[:3, 3]

    def plate(height: float) -> Cuboid:
        return Cuboid(kind="cuboid", name="plate", position=(*flange[:2].tolist(), height), size=(0.3, 0.3, 0.02))

    heights = np.arange(flange[2] - 0.3, flange[2], 0.001).tolist()
    touching = next(height for height in heights if Collisions(ROBOT, (plate(height),)).at(low))
    just_below = plate(touching - 0.002)
    load(planner, just_below)
    answer = plan(planner, PlanRequest(start=low, goal=to_joints(*HOME)))
    assert answer.clearance < 0.003
    assert_sound(answer, low, (just_below,))


def test_the_measured_state_is_the_start_unless_the_request_has_one(planner: Bus) -> None:
    load(planner)
    with pytest.raises(ExecutionRefused) as caught:
        plan(planner, PlanRequest(goal=to_joints(*HOME)))
    assert caught.value.code == "no_joint_state"
    states = planner.publisher(KEYS.joint_states, JointState)
    order = (0, 1, 3, 4, 2, 5)  # as the driver on ROS Humble does
    names = tuple(ROBOT.descriptor.joints[i] for i in order)
    measured = (0.1, 0.2, 1.3, 0.4, 1.5, 0.6)
    state = JointState(
        stamp=0.0, joint_names=names, position=tuple(measured[i] for i in order), velocity=(0.0,) * len(names)
    )

    def planned() -> Plan | None:
        states.put(state)
        try:
            return plan(planner, PlanRequest(goal=to_joints(*HOME)))
        except ExecutionRefused:
            return None

    answer = eventually(planned, "the planner has received the measured state")
    assert np.allclose(answer.trajectory.position[0], measured, atol=1e-9)


def test_measured_states_that_lack_a_joint_are_no_start(planner: Bus) -> None:
    load(planner)
    states = planner.publisher(KEYS.joint_states, JointState)
    state = JointState(stamp=0.0, joint_names=("joint_1",), position=(0.0,), velocity=(0.0,))

    def refusal() -> str | None:
        states.put(state)
        with pytest.raises(ExecutionRefused) as caught:
            plan(planner, PlanRequest(goal=to_joints(*HOME)))
        return caught.value.problem.joint

    assert eventually(refusal, "the planner has received the state") == "joint_2"


BAD = {
    "unreachable": (
        {"start": HOME, "goal": {"kind": "pose", "position": [3.0, 0.0, 0.5]}}, "unreachable", "goal", None,
    ),
    "too few joints in the goal": (
        {"start": HOME, "goal": {"kind": "joints", "position": [0.0, 0.0]}}, "invalid_request", "goal.position", None,
    ),
    "too many joints in the start": (
        {"start": [0.0] * 7, "goal": {"kind": "joints", "position": HOME}}, "invalid_request", "start", None,
    ),
    "goal out of range": (
        {"start": HOME, "goal": {"kind": "joints", "position": [0.0, 0.0, 3.0, 0.0, 0.0, 0.0]}},
        "invalid_request", "goal.position.2", "joint_3",
    ),
    "start out of range": (
        {"start": [0.0, 9.0, 0.0, 0.0, 0.0, 0.0], "goal": {"kind": "joints", "position": HOME}},
        "invalid_request", "start.1", "joint_2",
    ),
    "start in itself": (
        {"start": [1.2, -1.2, -2.79, 2.8, -1.2, -1.1], "goal": {"kind": "joints", "position": HOME}},
        "start_in_collision", "start", None,
    ),
    "start in an object": (
        {"start": [0.7854, 0.0, 1.570796, 0.0, 1.570796, 0.0], "goal": {"kind": "joints", "position": HOME}},
        "start_in_collision", "start", None,
    ),
    "goal in an object": (
        {"start": HOME, "goal": {"kind": "joints", "position": [0.7854, 0.0, 1.570796, 0.0, 1.570796, 0.0]}},
        "goal_in_collision", "goal", None,
    ),
    "pose in an object": (
        {"start": HOME, "goal": {"kind": "pose", "position": [0.6, 0.0, -0.1], "orientation": [1.0, 0.0, 0.0, 0.0]}},
        "goal_in_collision", "goal", None,
    ),
    "unnormalised quaternion": (
        {"start": HOME, "goal": {"kind": "pose", "position": [0.5, 0.0, 0.5], "orientation": [1.0, 1.0, 0.0, 0.0]}},
        "invalid_request", "goal.orientation", None,
    ),
    "no number": (
        {"start": HOME, "goal": {"kind": "joints", "position": ["a"] * 6}}, "invalid_request", "goal.position.0", None,
    ),
    "no time": (
        {"start": HOME, "goal": {"kind": "joints", "position": HOME}, "timeout": 0.0}, "invalid_request", "timeout", None,
    ),
    "a word too many": (
        {"start": HOME, "goal": {"kind": "joints", "position": HOME}, "speed": 1.0}, "invalid_request", "speed", None,
    ),
    "hours of motion": (
        {"start": HOME, "goal": {"kind": "joints", "position": [1.0, *HOME[1:]]}, "velocity_scale": 1e-5},
        "invalid_request", "velocity_scale", None,
    ),
    "nothing": ({}, "invalid_request", "goal", None),
}  # fmt: skip


@pytest.fixture(scope="module")
def foreign(planner: Bus, place: str) -> Iterator[zenoh.Session]:
    """A client that knows nothing of zarm."""
    session = open_client(place)
    yield session
    session.close()  # type: ignore[no-untyped-call]


def problem(session: zenoh.Session, key: str, payload: bytes) -> Problem:
    (reply,) = session.get(key, payload=payload, timeout=PATIENCE)
    assert reply.err is not None
    return Problem.model_validate_json(reply.err.payload.to_bytes())


@pytest.mark.parametrize("case", BAD)
def test_a_bad_request_is_answered_with_its_fault(planner: Bus, foreign: zenoh.Session, case: str) -> None:
    request, code, field, joint = BAD[case]
    load(planner, TABLE, POST)
    fault = problem(foreign, KEYS.plan, json.dumps(request).encode())
    assert (fault.code, fault.field, fault.joint) == (code, field, joint)
    assert len(fault.message) > 20
    assert is_alive(planner)


def test_a_collision_names_the_pair_and_its_depth(planner: Bus, foreign: zenoh.Session) -> None:
    load(planner, TABLE, POST)
    request, _, _, _ = BAD["start in an object"]
    assert re.search(
        r"link_\d is \d+\.\d mm inside post", problem(foreign, KEYS.plan, json.dumps(request).encode()).message
    )


def test_an_unreachable_pose_says_how_near_the_tip_comes(planner: Bus, foreign: zenoh.Session) -> None:
    request, _, _, _ = BAD["unreachable"]
    assert re.search(r"\d+\.\d mm and \d+\.\d deg", problem(foreign, KEYS.plan, json.dumps(request).encode()).message)


@pytest.mark.parametrize(
    "key", [KEYS.plan, KEYS.plan_cancel, KEYS.ik, KEYS.fk, KEYS.check, KEYS.settings, KEYS.scene_edit]
)
@pytest.mark.parametrize("noise", [random.Random(1).randbytes(2**20), b"[" * 2**20, b'{"goal": null}', b"\x00"])
def test_noise_is_an_invalid_request_on_every_key(planner: Bus, foreign: zenoh.Session, key: str, noise: bytes) -> None:
    assert problem(foreign, key, noise).code == "invalid_request"
    assert is_alive(planner)


def test_inverse_kinematics_bring_the_tip_where_it_was_asked_to_be(planner: Bus) -> None:
    load(planner)
    poses = planner.call(KEYS.fk, FkRequest(joints=(HOME, BEHIND_POST)), FkPoses, timeout=PATIENCE).poses
    for q, pose in zip((HOME, BEHIND_POST), poses, strict=True):
        assert tip_error(ROBOT, q, pose.position, pose.orientation) == pytest.approx((0.0, 0.0), abs=1e-6)
    answer = planner.call(KEYS.ik, IkRequest(poses=poses, near=HOME, max_solutions=8), IkSolutions, timeout=PATIENCE)
    for pose, solutions in zip(poses, answer.solutions, strict=True):
        assert len(solutions) == 8
        for q in solutions:
            assert tip_error(ROBOT, q, pose.position, pose.orientation) == pytest.approx((0.0, 0.0), abs=1e-4)
        away = [np.linalg.norm(np.subtract(q, HOME)) for q in solutions]
        assert away == sorted(away)


def test_inverse_kinematics_avoid_the_scene_unless_told_not_to(planner: Bus) -> None:
    load(planner, POST)
    inside = Pose(position=POST.position, orientation=(1.0, 0.0, 0.0, 0.0))
    outside = Pose(position=(0.4, -0.4, 0.4), orientation=(1.0, 0.0, 0.0, 0.0))
    request = IkRequest(poses=(inside, outside))
    solutions = planner.call(KEYS.ik, request, IkSolutions, timeout=PATIENCE).solutions
    assert [len(found) for found in solutions] == [0, 1]
    anyway = request.model_copy(update={"collision_free": False})
    assert [len(found) for found in planner.call(KEYS.ik, anyway, IkSolutions, timeout=PATIENCE).solutions] == [1, 1]


def test_a_check_tells_distance_pair_and_range(planner: Bus) -> None:
    load(planner, POST)
    into_post = (float(np.pi / 4), *HOME[1:])
    request = CheckRequest(joints=(HOME, into_post, (0.0, 0.0, 3.0, 0.0, 0.0, 0.0)))
    home, post, folded = planner.call(KEYS.check, request, CheckResults, timeout=PATIENCE).results
    assert (home.in_collision, home.within_limits) == (False, True)
    assert home.clearance > 0.0
    assert (post.in_collision, post.within_limits) == (True, True)
    assert post.clearance < 0.0
    assert post.pair is not None
    assert post.pair[1] == "post"
    assert not folded.within_limits


def test_a_deadline_ends_a_search_that_finds_nothing(planner: Bus) -> None:
    load(planner, WALL, LID)
    with pytest.raises(DeadlineExceeded, match=r"0\.3 s"):
        plan(planner, PlanRequest(start=HOME, goal=to_joints(*BEHIND_WALL), timeout=0.3))


def endless(planner: Bus, request_id: str, answers: list[ZarmError]) -> threading.Thread:
    """Ask for what takes a minute in vain, in a thread of its own; its answer goes to `answers`."""

    def ask() -> None:
        with pytest.raises(ZarmError) as caught:
            plan(planner, PlanRequest(start=HOME, goal=to_joints(*BEHIND_WALL), timeout=60.0, request_id=request_id))
        answers.append(caught.value)

    thread = threading.Thread(target=ask)
    thread.start()
    return thread


def cancel(bus: Bus, request_id: str) -> bool:
    return bus.call(KEYS.plan_cancel, CancelPlan(request_id=request_id), CancelledPlan, timeout=PATIENCE).was_running


def test_a_cancel_ends_the_planning_that_it_names(planner: Bus) -> None:
    load(planner, WALL, LID)
    answers: list[ZarmError] = []
    thread = endless(planner, "in-vain", answers)
    assert not cancel(planner, "something-else")
    eventually(lambda: cancel(planner, "in-vain"), "the planning has begun and is cancelled")
    thread.join(PATIENCE)
    assert [type(answer) for answer in answers] == [Cancelled]
    assert not cancel(planner, "in-vain")


def test_requests_that_wait_for_their_turn_can_be_cancelled_and_too_many_are_refused(planner: Bus) -> None:
    load(planner, WALL, LID)
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


def test_settings_change_whole_or_not_at_all_and_are_published(planner: Bus, foreign: zenoh.Session) -> None:
    seen: list[PlannerSettings] = []
    planner.watch(KEYS.settings, PlannerSettings, lambda _, message: seen.append(message))
    before = eventually(lambda: seen, "the present settings are read")[0]
    fault = problem(foreign, KEYS.settings, b'{"margin": 0.01, "velocity_scale": 2.0}')
    assert (fault.code, fault.field) == ("invalid_request", "velocity_scale")
    assert planner.call(KEYS.settings, SettingsChange(), PlannerSettings, timeout=PATIENCE) == before
    changed = planner.call(KEYS.settings, SettingsChange(margin=0.02, timeout=9.0), PlannerSettings, timeout=PATIENCE)
    assert changed == before.model_copy(update={"margin": 0.02, "timeout": 9.0})
    assert eventually(lambda: seen[1:], "the change is published") == [changed]
    back = SettingsChange(margin=before.margin, timeout=before.timeout)
    assert planner.call(KEYS.settings, back, PlannerSettings, timeout=PATIENCE) == before


def test_a_margin_keeps_goals_away_from_objects(planner: Bus) -> None:
    flange = link_pose(ROBOT, "link_6", HOME)[:3, 3]
    near = Sphere(kind="sphere", name="near", position=(*flange[:2].tolist(), float(flange[2]) - 0.2), radius=0.1)
    load(planner, near)
    goal = PlanRequest(start=BEHIND_POST, goal=to_joints(*HOME))
    assert plan(planner, goal).clearance < 0.09
    planner.call(KEYS.settings, SettingsChange(margin=0.15), PlannerSettings, timeout=PATIENCE)
    try:
        with pytest.raises(ZarmError, match="too near") as caught:
            plan(planner, goal)
        assert caught.value.code == "goal_in_collision"
    finally:
        planner.call(KEYS.settings, SettingsChange(margin=0.005), PlannerSettings, timeout=PATIENCE)


def test_plans_are_published_and_the_last_one_is_there_for_late_comers(planner: Bus, place: str) -> None:
    load(planner)
    answer = plan(planner, PlanRequest(start=HOME, goal=to_joints(*BEHIND_POST)))
    with Bus(place) as late:
        seen: list[Plan] = []
        late.watch(KEYS.plans, Plan, lambda _, message: seen.append(message))
        assert eventually(lambda: seen, "the last plan is there") == [answer]
        second = plan(planner, PlanRequest(start=HOME, goal=to_joints(*HOME)))
        assert eventually(lambda: seen[1:], "the next plan arrives") == [second]


def test_the_scene_is_published_with_every_edit_whole_and_object_by_object(
    planner: Bus, foreign: zenoh.Session
) -> None:
    first = load(planner, TABLE, POST)
    scenes: list[Scene] = []
    planner.watch(KEYS.scene, Scene, lambda _, message: scenes.append(message))
    edit = SceneEdit(edit=AddObjects(op="add", objects=(SHELF,)))
    edited = planner.call(KEYS.scene_edit, edit, SceneEdited, timeout=PATIENCE)
    assert edited == SceneEdited(revision=first.revision + 1, count=3)
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
    assert str(post.encoding).endswith("zarm.Cylinder.v1")
    planner.call(KEYS.scene_edit, SceneEdit(edit=ClearScene(op="clear")), SceneEdited, timeout=PATIENCE)
    assert list(foreign.get(KEYS.scene_object("*"), timeout=PATIENCE)) == []


def test_a_plan_is_made_in_the_scene_of_the_revision_that_it_states(planner: Bus) -> None:
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
        scene = fresh.call(KEYS.scene, Nothing(), Scene, timeout=PATIENCE)
        assert scene == Scene(revision=edited.revision, objects=(TABLE, POST))


def test_a_scene_that_cannot_be_read_stops_planning_until_it_is_edited(endpoint: str, bus: Bus, tmp_path: Path) -> None:
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


def test_a_second_planner_of_one_robot_is_refused_and_one_of_another_name_is_not(
    planner: Bus, place: str, tmp_path: Path
) -> None:
    with ServiceProcess("planner", place, tmp_path) as second:
        assert second.process.wait(PATIENCE) == 1
        assert "already on this bus" in second.output()
    with ServiceProcess("planner", place, tmp_path, name="twin") as twin:
        twin.wait_ready(planner, Keys("twin"))
        request = PlanRequest(start=HOME, goal=to_joints(*BEHIND_POST))
        assert planner.call(Keys("twin").plan, request, Plan, timeout=PATIENCE).robot == "twin"


def test_health_answers_while_kernels_are_compiled_and_plans_are_refused_with_the_reason(
    endpoint: str, bus: Bus, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "nothing_compiled_yet"))
    with ServiceProcess("planner", endpoint, tmp_path) as process:

        def busy() -> Health | None:
            try:
                health = bus.call(KEYS.health("planner"), Nothing(), Health, timeout=5)
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
        load(bus, WALL, LID)
        answers: list[ZarmError] = []
        threads = [endless(bus, f"last-{i}", answers) for i in range((os.cpu_count() or 1) + 20)]
        eventually(lambda: answers, "so many are in hand that one more is refused")
        process.process.terminate()
        for thread in threads:
            thread.join(PATIENCE)
        assert process.process.wait(PATIENCE) == 0
        assert {type(answer) for answer in answers} == {Busy, Unavailable}
        assert all("shutting down" in str(answer) for answer in answers if isinstance(answer, Unavailable))
