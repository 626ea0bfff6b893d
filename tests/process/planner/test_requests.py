"""Every other request to the planner, bad ones among them: what is answered, and that it goes on answering."""

from __future__ import annotations

import json
import random
import re

import numpy as np
import pytest
import zenoh

from support.harness import PATIENCE, eventually
from support.planner.client import (
    BEHIND_POST,
    HOME,
    KEYS,
    POST,
    ROBOT,
    TABLE,
    assert_sound,
    is_alive,
    load,
    plan,
    to_joints,
)
from support.planner.second_opinion import Collisions, link_pose, tip_error
from zarm_contract.errors import Problem
from zarm_contract.messages import (
    CheckRequest,
    FkRequest,
    IkRequest,
    PlannerSettings,
    PlanRequest,
    Pose,
    SettingsChange,
    Sphere,
)
from zarm_runtime.bus import Bus

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
    "key", [KEYS.plan, KEYS.plan_cancel, KEYS.ik, KEYS.fk, KEYS.check, KEYS.occupancy, KEYS.settings, KEYS.scene_edit]
)
@pytest.mark.parametrize(
    "noise",
    [random.Random(1).randbytes(2**20), b"[" * 2**20, b'{"goal": null}', b"\x00"],
    ids=["random", "brackets", "null", "zero"],
)
def test_noise_is_an_invalid_request_on_every_key(planner: Bus, foreign: zenoh.Session, key: str, noise: bytes) -> None:
    assert problem(foreign, key, noise).code == "invalid_request"
    assert is_alive(planner)


def test_inverse_kinematics_reach_the_requested_pose(planner: Bus) -> None:
    load(planner)
    poses = planner.call(KEYS.fk, FkRequest(joints=(HOME, BEHIND_POST)), timeout=PATIENCE).poses
    for q, pose in zip((HOME, BEHIND_POST), poses, strict=True):
        assert tip_error(ROBOT, q, pose.position, pose.orientation) == pytest.approx((0.0, 0.0), abs=1e-6)
    answer = planner.call(KEYS.ik, IkRequest(poses=poses, near=HOME, max_solutions=8), timeout=PATIENCE)
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
    solutions = planner.call(KEYS.ik, request, timeout=PATIENCE).solutions
    assert [len(found) for found in solutions] == [0, 1]
    anyway = request.model_copy(update={"collision_free": False})
    assert [len(found) for found in planner.call(KEYS.ik, anyway, timeout=PATIENCE).solutions] == [1, 1]


def test_a_check_tells_distance_pair_and_range(planner: Bus) -> None:
    load(planner, POST)
    into_post = (float(np.pi / 4), *HOME[1:])
    request = CheckRequest(joints=(HOME, into_post, (0.0, 0.0, 3.0, 0.0, 0.0, 0.0)))
    home, post, folded = planner.call(KEYS.check, request, timeout=PATIENCE).results
    assert (home.in_collision, home.within_limits) == (False, True)
    assert home.clearance > 0.0
    assert (post.in_collision, post.within_limits) == (True, True)
    assert post.clearance < 0.0
    assert post.pair is not None
    assert post.pair[1] == "post"
    assert not folded.within_limits


def test_settings_change_whole_or_not_at_all_and_are_published(planner: Bus, foreign: zenoh.Session) -> None:
    seen: list[PlannerSettings] = []
    planner.watch(KEYS.settings, lambda _, message: seen.append(message))
    before = eventually(lambda: seen, "the present settings are read")[0]
    fault = problem(foreign, KEYS.settings, b'{"margin": 0.01, "velocity_scale": 2.0}')
    assert (fault.code, fault.field) == ("invalid_request", "velocity_scale")
    assert planner.call(KEYS.settings, SettingsChange(), timeout=PATIENCE) == before
    changed = planner.call(KEYS.settings, SettingsChange(margin=0.02, timeout=9.0), timeout=PATIENCE)
    assert changed == before.model_copy(update={"margin": 0.02, "timeout": 9.0})
    assert eventually(lambda: seen[1:], "the change is published") == [changed]
    back = SettingsChange(margin=before.margin, timeout=before.timeout)
    assert planner.call(KEYS.settings, back, timeout=PATIENCE) == before


def test_a_margin_is_kept_on_the_way_and_a_goal_may_be_nearer(planner: Bus) -> None:
    flange = link_pose(ROBOT, "link_6", HOME)[:3, 3]
    near = Sphere(kind="sphere", name="near", position=(*flange[:2].tolist(), float(flange[2]) - 0.15), radius=0.1)
    thick = POST.model_copy(update={"radius": POST.radius + 0.06})
    wide = near.model_copy(update={"radius": near.radius + 0.06})
    assert Collisions(ROBOT, (wide,)).at(HOME)
    planner.call(KEYS.settings, SettingsChange(margin=0.08), timeout=PATIENCE)
    try:
        load(planner, POST)
        around = assert_sound(plan(planner, PlanRequest(start=HOME, goal=to_joints(*BEHIND_POST))), HOME, (thick,))
        assert np.allclose(around, BEHIND_POST, atol=1e-6)
        load(planner, near)
        answer = plan(planner, PlanRequest(start=BEHIND_POST, goal=to_joints(*HOME)))
        assert np.allclose(assert_sound(answer, BEHIND_POST, (near,)), HOME, atol=1e-6)
    finally:
        planner.call(KEYS.settings, SettingsChange(margin=0.005), timeout=PATIENCE)


def test_a_request_may_state_the_margin_that_it_keeps(planner: Bus) -> None:
    thick = POST.model_copy(update={"radius": POST.radius + 0.06})
    load(planner, POST)
    for margin, kept in ((0.08, (thick,)), (0.0, (POST,)), (0.08, (thick,))):
        request = PlanRequest(start=HOME, goal=to_joints(*BEHIND_POST), margin=margin)
        assert np.allclose(assert_sound(plan(planner, request), HOME, kept), BEHIND_POST, atol=1e-6)
    assert planner.call(KEYS.settings, SettingsChange(), timeout=PATIENCE).margin == 0.005
