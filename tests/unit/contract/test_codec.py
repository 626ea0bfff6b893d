"""The codec, for any bytes: what is valid passes unchanged, everything else is refused as one typed error."""

from __future__ import annotations

import json
import math
import re
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from support.message_examples import EXAMPLES, by_class
from zarm_contract import messages as m
from zarm_contract.codec import decode, encode
from zarm_contract.errors import InvalidRequest
from zarm_contract.messages import Message

# -- whatever arrives --

CLASSES = sorted(by_class(), key=lambda cls: cls.__name__)

json_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=8), inner, max_size=4),
    max_leaves=12,
)


def read_or_refuse(cls: type[Message], payload: bytes) -> None:
    """Decode; the outcome is a message that survives the wire, or InvalidRequest; any other exception escapes."""
    try:
        message = decode(cls, payload)
    except InvalidRequest:
        return
    assert decode(cls, encode(message)) == message


@given(cls=st.sampled_from(CLASSES), payload=st.binary(max_size=200))
def test_arbitrary_bytes_are_read_or_refused(cls: type[Message], payload: bytes) -> None:
    read_or_refuse(cls, payload)


@given(cls=st.sampled_from(CLASSES), value=json_values)
def test_arbitrary_json_is_read_or_refused(cls: type[Message], value: Any) -> None:
    read_or_refuse(cls, json.dumps(value).encode())


@given(data=st.data(), example=st.sampled_from(EXAMPLES), value=json_values)
def test_a_message_with_one_value_replaced_is_read_or_refused(
    data: st.DataObject, example: Message, value: Any
) -> None:
    payload = json.loads(encode(example))
    place = payload
    while place:
        key = data.draw(st.sampled_from(sorted(place) if isinstance(place, dict) else range(len(place))))
        if isinstance(place[key], dict | list) and data.draw(st.booleans()):
            place = place[key]
        else:
            place[key] = value
            break
    read_or_refuse(type(example), json.dumps(payload).encode())


@given(data=st.data(), example=st.sampled_from(EXAMPLES))
def test_a_message_cut_short_is_refused(data: st.DataObject, example: Message) -> None:
    payload = encode(example)
    cut = data.draw(st.integers(min_value=1, max_value=len(payload) - 1))
    with pytest.raises(InvalidRequest):
        decode(type(example), payload[:cut])


@pytest.mark.parametrize(
    "payload",
    [
        b"[" * 100_000,
        b'{"goal":' * 100_000,
        b"\xff\xfe",
        b'{"goal": "\\ud800"}',
        b"1" * 5000,
        b"null",
        b"[]",
        b'"x"',
        b"\0",
    ],
    ids=[
        "deep list",
        "deep object",
        "no UTF-8",
        "lone surrogate",
        "long number",
        "null",
        "list",
        "string",
        "zero byte",
    ],
)
def test_hostile_payloads_are_refused(payload: bytes) -> None:
    with pytest.raises(InvalidRequest):
        decode(m.PlanRequest, payload)


def test_no_payload_at_all_is_an_empty_request() -> None:
    assert decode(m.SettingsChange, b"") == m.SettingsChange()
    assert decode(m.Nothing, b"") == m.Nothing()
    with pytest.raises(InvalidRequest) as refusal:
        decode(m.PlanRequest, b"")
    assert refusal.value.problem.field == "goal"


def test_a_refusal_says_how_many_faults_follow_the_first() -> None:
    with pytest.raises(InvalidRequest, match="and 2 more") as refusal:
        decode(m.PlannerSettings, b'{"timeout": 0, "velocity_scale": 2, "margin": 1}')
    assert refusal.value.problem.field == "timeout"


def test_a_refusal_names_the_field_as_the_sender_wrote_it() -> None:
    """Pydantic's own path would be `edit.add.objects.0.sphere.radius`."""
    ball = b'{"edit": {"op": "add", "objects": [{"kind": "sphere", "name": "radius", "position": [0, 0, 0]}]}}'
    with pytest.raises(InvalidRequest) as refusal:
        decode(m.SceneEdit, ball)
    assert refusal.value.problem.field == "edit.objects.0.radius"


# -- whatever is sent --

numbers = st.floats(allow_nan=False, allow_infinity=False)
vectors = st.tuples(numbers, numbers, numbers)
names = st.from_regex(r"[A-Za-z0-9_.-]{1,64}", fullmatch=True)
lengths = st.floats(min_value=0, exclude_min=True, allow_infinity=False)


@st.composite
def rotations(draw: st.DrawFn) -> tuple[float, float, float, float]:
    part = st.floats(min_value=-1, max_value=1)
    q = draw(st.tuples(part, part, part, part).filter(lambda q: math.hypot(*q) > 0.1))
    norm = math.hypot(*q)
    return (q[0] / norm, q[1] / norm, q[2] / norm, q[3] / norm)


@st.composite
def trajectories(draw: st.DrawFn) -> m.Trajectory:
    joints = draw(st.lists(st.text(), min_size=1, max_size=8, unique=True))
    later = st.lists(
        st.floats(min_value=0, exclude_min=True, allow_infinity=False), min_size=1, max_size=6, unique=True
    )
    time = (0.0, *sorted(draw(later)))
    row = st.tuples(*[numbers] * len(joints))
    rows = st.tuples(*[row] * len(time))
    return m.Trajectory(
        joint_names=tuple(joints), time=time, position=draw(rows), velocity=draw(rows), acceleration=draw(rows)
    )


poses = st.builds(m.Pose, position=vectors, orientation=rotations())
scene_objects = st.one_of(
    st.builds(
        m.Cuboid,
        kind=st.just("cuboid"),
        name=names,
        position=vectors,
        orientation=rotations(),
        size=st.tuples(lengths, lengths, lengths),
    ),
    st.builds(m.Sphere, kind=st.just("sphere"), name=names, position=vectors, radius=lengths),
    *(
        st.builds(
            shape,
            kind=st.just(kind),
            name=names,
            position=vectors,
            orientation=rotations(),
            radius=lengths,
            length=lengths,
        )
        for kind, shape in (("capsule", m.Capsule), ("cylinder", m.Cylinder))
    ),
)
revisions = st.from_regex(r"[1-9][0-9]{0,17}-[0-9a-f]{12}", fullmatch=True)
scenes = st.builds(m.Scene, revision=revisions, objects=st.lists(scene_objects, max_size=5).map(tuple))


@given(message=st.one_of(trajectories(), poses, scenes))
def test_every_number_survives_the_wire_to_the_last_bit(message: Message) -> None:
    arrived = decode(type(message), encode(message))
    assert arrived == message
    assert encode(arrived) == encode(message)  # == takes -0.0 for 0.0; the bytes do not


@given(
    parts=st.tuples(*[st.floats(min_value=-1, max_value=1)] * 4).filter(lambda q: math.hypot(*q) > 0.1),
    error=st.floats(-9e-4, 9e-4),
)
def test_a_quaternion_is_normalised_once_and_then_stays_as_it_is(parts: tuple[float, ...], error: float) -> None:
    scale = (1 + error) / math.hypot(*parts)
    x, y, z, w = (part * scale for part in parts)
    pose = m.Pose(position=(0.0, 0.0, 0.0), orientation=(x, y, z, w))
    assert math.hypot(*pose.orientation) == pytest.approx(1.0, abs=2e-12)
    assert decode(m.Pose, encode(pose)) == pose


# -- what is made to hold up whoever reads it --


@pytest.mark.parametrize(
    ("cls", "payload"),
    [
        (m.DriverCommand, b'{"sequence": 1, "joint_names": ["a"], "time": [%s]}' % b",".join([b'""'] * 10_000)),
        (
            m.DriverCommand,
            b'{"sequence": 1, "joint_names": ["a"], "time": [0], "position": [%s]}' % b",".join([b"[]"] * 9999),
        ),
        (m.Plan, b'{"waypoint_times": [%s]}' % b",".join([b"{}"] * 10_000)),
        (m.IkRequest, b'{"poses": [%s]}' % b",".join([b"{}"] * 10_000)),
        (m.SceneEdit, b'{"edit": {"op": "add", "objects": [%s]}}' % b",".join([b"{}"] * 10_000)),
    ],
)
def test_of_a_row_of_faults_only_the_first_is_looked_at(cls: type[Message], payload: bytes) -> None:
    with pytest.raises(InvalidRequest) as refusal:
        decode(cls, payload)
    assert not re.search(r"and \d{3,} more", str(refusal.value))


TARGET = '{"goal_id": "jog", "sequence": 1, "stamp": 1.0, "target": %s}'


@pytest.mark.parametrize(
    ("cls", "payload", "problem"),
    [
        (
            m.ServoTarget,
            TARGET % '{"kind": "twist"}',
            'ServoTarget: Field required; write "base" or "tool" (target.frame)',
        ),
        (
            m.ServoTarget,
            TARGET % '{"kind": "pose", "position": [0.5, 0, 0.5], "orientation": [0, 0, 0, 1]}',
            'ServoTarget: Field required; write "base" (target.frame)',
        ),
        (m.ServoTarget, TARGET % "{}", '; write "pose", "twist", "joint_speed" or "joints" (target)'),
        (
            m.SceneEdit,
            '{"edit": {"op": "add", "objects": [{"name": "a"}]}}',
            '"mesh", "voxels" or "cloud" (edit.objects.0)',
        ),
        (
            m.SceneEdit,
            '{"edit": {"op": "attach"}}',
            "SceneEdit: Field required; docs/reference/messages.md explains what to write here (edit.name)",
        ),
        (
            m.SceneEdit,
            '{"edit": {"op": "add", "objects": [{"kind": "sphere", "name": "a", "radius": 1, "position": [0, 0, 0], "sise": 1}]}}',
            "SceneEdit: Extra inputs are not permitted; docs/reference/messages.md lists the fields (edit.objects.0.sise)",
        ),
        (
            m.PlanRequest,
            '{"goal": {"kind": "pose", "position": [0.5, 0, 0.5], "orientatoin": [0, 0, 0, 1]}}',
            "PlanRequest: Extra inputs are not permitted; did you mean orientation? (goal.orientatoin)",
        ),
    ],
)
def test_missing_and_unknown_fields_are_named_with_the_remedy(cls: type[Message], payload: str, problem: str) -> None:
    with pytest.raises(InvalidRequest) as refusal:
        decode(cls, payload.encode())
    assert str(refusal.value).endswith(problem)


def test_no_more_fields_are_read_than_the_largest_scene_has() -> None:
    many = b"{%s}" % b",".join(b'"a%d": 0' % number for number in range(100_001))
    with pytest.raises(InvalidRequest, match="more than 100000 fields"):
        decode(m.ExecuteRequest, many)
    with pytest.raises(InvalidRequest, match="more than 1000000 values"):
        decode(m.ExecuteRequest, b"[%s]" % (b"0," * 1_000_001))
    with pytest.raises(InvalidRequest, match=r"Field required; .* \(plan_id\)"):
        decode(m.Plan, b'{"trajectory": [%s 0]}' % (b"[], " * 100_000))
    ball = m.Sphere(kind="sphere", name="ball", position=(0.0, 0.0, 0.0), radius=1.0)
    scene = m.Scene(
        revision="1-5be0c1d2f3a4",
        objects=tuple(ball.model_copy(update={"name": f"b{n}"}) for n in range(m.MAX_OBJECTS)),
    )
    assert decode(m.Scene, encode(scene)) == scene


@pytest.mark.parametrize("cls", [m.JointState, m.DriverProgress, m.CancelRequest, m.Nothing, m.StrategyRequest])
def test_messages_that_stop_or_control_a_robot_are_short(cls: type[Message]) -> None:
    with pytest.raises(InvalidRequest, match="over the limit of 16384"):
        decode(cls, b"{%s}" % (b" " * 20_000))


def test_joint_states_of_the_most_joints_are_not_too_long() -> None:
    awkward = (-1.2345678901234567e-300,) * 32
    state = m.JointState(
        stamp=1.75e9, joint_names=tuple(f"{n:0>100}" for n in range(32)), position=awkward, velocity=awkward
    )
    assert decode(m.JointState, encode(state)) == state


@pytest.mark.parametrize(
    ("cls", "payload"),
    [
        (m.ExecuteRequest, b'{"%s": 1}' % (b"x" * 1_000_000)),
        (m.SceneEdit, b'{"edit": {"op": "%s"}}' % (b"x" * 1_000_000)),
        (m.DriverCommand, b'{"sequence": 1, "joint_names": ["%s", "%s"]}' % (b"x" * 1_000_000, b"x" * 1_000_000)),
    ],
)
def test_a_refusal_quotes_little_of_what_it_refuses(cls: type[Message], payload: bytes) -> None:
    with pytest.raises(InvalidRequest) as refusal:
        decode(cls, payload)
    assert len(encode(refusal.value.problem)) < 2000


def test_a_number_that_not_every_language_holds_is_refused() -> None:
    with pytest.raises(InvalidRequest) as refused:
        decode(m.Authority, json.dumps({"servo": "s", "sequence": 2**53}).encode())
    assert refused.value.problem.field == "sequence"


def test_numbers_of_numpy_are_written_as_those_of_python() -> None:
    plain = m.JointState(stamp=1.5, joint_names=("a", "b"), position=(0.25, -1e-7), velocity=(0.0, 3.0))
    numbers = m.JointState.model_construct(
        stamp=np.float64(1.5),
        joint_names=("a", "b"),
        position=tuple(np.array([0.25, -1e-7])),
        velocity=(np.float64(0.0), np.int64(3)),
    )
    assert decode(m.JointState, encode(numbers)) == plain
