"""Input that no client should send: each is answered with its fault, nothing hangs, and the planner plans on."""

from __future__ import annotations

import json
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
import zenoh

from support.harness import PATIENCE
from support.planner.client import HOME, KEYS
from zarm_contract.errors import Busy, Problem
from zarm_contract.messages import (
    MAX_OBJECTS,
    JointGoal,
    LoadScene,
    Nothing,
    PlanRequest,
    SceneEdit,
    Sphere,
)
from zarm_runtime.bus import Bus

GOOD = PlanRequest(start=HOME, goal=JointGoal(kind="joints", position=(0.5, *HOME[1:])))
TO_HOME = {"kind": "joints", "position": HOME}


@pytest.fixture(autouse=True)
def still_plans(planner: Bus) -> Iterator[None]:
    """After whatever a test has sent: the planner is well, and a request in order is answered with a plan."""
    planner.call(KEYS.scene_edit, SceneEdit(edit=LoadScene(op="load", objects=(ball("known"),))), timeout=PATIENCE)
    yield
    assert planner.call(KEYS.health("planner"), Nothing(), timeout=PATIENCE).ready
    answer = planner.call(KEYS.plan, GOOD, timeout=PATIENCE)
    assert answer.trajectory.position[-1] == pytest.approx((0.5, *HOME[1:]), abs=1e-6)


def ball(name: str, x: float = 2.0, radius: float = 0.1) -> Sphere:
    return Sphere(kind="sphere", name=name, position=(x, 0.0, 1.0), radius=radius)


def problem(session: zenoh.Session, key: str, payload: bytes) -> Problem:
    (reply,) = session.get(key, payload=payload, timeout=PATIENCE)
    assert reply.err is not None
    return Problem.model_validate_json(reply.err.payload.to_bytes())


def pose(**fields: object) -> dict[str, object]:
    return {"start": HOME, "goal": {"kind": "pose", "position": [0.5, 0.0, 0.5], **fields}}


def added(**fields: object) -> dict[str, object]:
    thing = {"kind": "cuboid", "name": "new", "position": [2.0, 0.0, 0.0], "size": [0.1, 0.1, 0.1], **fields}
    return {"edit": {"op": "add", "objects": [thing]}}


def attached(**fields: object) -> dict[str, object]:
    return {"edit": {"op": "attach", "name": "known", "joints": HOME, **fields}}


NAN, HUGE = float("nan"), 1e400
PLAN, EDIT, CHECK, IK = KEYS.plan, KEYS.scene_edit, KEYS.check, KEYS.ik
BAD = {
    "a quaternion of zeros": (PLAN, pose(orientation=[0.0, 0.0, 0.0, 0.0]), "goal.orientation"),
    "a quaternion twice as long": (PLAN, pose(orientation=[0.0, 0.0, 0.0, 2.0]), "goal.orientation"),
    "a pose that is no number": (PLAN, pose(position=[0.5, NAN, 0.5]), "goal.position.1"),
    "an infinite pose": (PLAN, pose(position=[0.5, 0.0, HUGE]), "goal.position.2"),
    "joints that are no numbers": (PLAN, {"start": [NAN] * 6, "goal": TO_HOME}, "start.0"),
    "a goal of no kind": (PLAN, {"start": HOME, "goal": {"position": [0.5, 0.0, 0.5]}}, "goal"),
    "a goal of an unknown kind": (PLAN, {"start": HOME, "goal": {"kind": "circle"}}, "goal"),
    "joints with a quaternion": (PLAN, {"start": HOME, "goal": {**TO_HOME, "orientation": [0, 0, 0, 1]}}, "goal.orientation"),
    "checks of too few joints": (CHECK, {"joints": [[0.0, 0.0]]}, "joints.0"),
    "no joints to check": (CHECK, {"joints": []}, "joints"),
    "near too many joints": (IK, {"poses": [{"position": [0.5, 0.0, 0.5]}], "near": [0.0] * 9}, "near"),
    "a name that exists": (EDIT, added(name="known"), "edit.objects.0.name"),
    "a name with a slash": (EDIT, added(name="a/b"), "edit.objects.0.name"),
    "an object without a length": (EDIT, added(size=[0.1, -0.1, 0.1]), "edit.objects.0.size.1"),
    "an object without a size": (EDIT, added(size=[0.0, 0.1, 0.1]), "edit.objects.0.size.0"),
    "an object that is nowhere": (EDIT, added(position=[NAN, 0.0, 0.0]), "edit.objects.0.position.0"),
    "an object turned by nothing": (EDIT, added(orientation=[0.0] * 4), "edit.objects.0.orientation"),
    "a load that is not there": (EDIT, attached(name="nothing"), "edit.name"),
    "a load that may touch no link": (EDIT, attached(touch_links=["finger"]), "edit.touch_links.0"),
    "a load at other joints": (EDIT, attached(joints=[0.0]), "edit.joints"),
    "a load at no joints": (EDIT, attached(joints=[NAN] * 6), "edit.joints.0"),
    "a load put down twice": (EDIT, {"edit": {"op": "detach", "name": "known", "joints": HOME}}, "edit.name"),
    "links of another robot": (EDIT, {"edit": {"op": "links", "names": ["finger"], "enabled": False}}, "edit.names.0"),
}  # fmt: skip


@pytest.mark.parametrize("case", BAD)
def test_a_bad_request_is_answered_with_its_fault(foreign: zenoh.Session, case: str) -> None:
    key, request, field = BAD[case]
    fault = problem(foreign, key, json.dumps(request).encode())
    assert (fault.code, fault.field) == ("invalid_request", field)
    assert len(fault.message) > 20


def test_a_scene_of_ten_thousand_objects_is_the_limit(planner: Bus, foreign: zenoh.Session) -> None:
    x = np.linspace(3.0, 900.0, MAX_OBJECTS - 1).tolist()
    many = LoadScene(op="load", objects=(ball("known"), *(ball(f"b{i}", x[i]) for i in range(MAX_OBJECTS - 1))))
    edited = planner.call(KEYS.scene_edit, SceneEdit(edit=many), timeout=PATIENCE)
    assert edited.count == MAX_OBJECTS
    assert planner.call(KEYS.plan, GOOD, timeout=PATIENCE).scene_revision == edited.revision
    fault = problem(foreign, KEYS.scene_edit, json.dumps(added()).encode())
    assert (fault.code, fault.field) == ("invalid_request", "edit.objects")
    assert str(MAX_OBJECTS) in fault.message


@pytest.mark.slow
def test_two_hundred_simultaneous_requests_are_all_answered(planner: Bus) -> None:
    def ask(seed: int) -> str:
        try:
            return type(planner.call(KEYS.plan, GOOD.model_copy(update={"seed": seed}), timeout=PATIENCE)).__name__
        except Busy:
            return "busy"

    with ThreadPoolExecutor(200) as clients:
        answers = list(clients.map(ask, range(200)))
    assert "Plan" in answers
    assert set(answers) <= {"Plan", "busy"}
