"""The codec, for any bytes: what is valid passes unchanged, everything else is refused as one typed error."""

from __future__ import annotations

import json
import math
from typing import Any

import pytest
from contract.examples import EXAMPLES, by_class
from hypothesis import given, settings
from hypothesis import strategies as st

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


@settings(deadline=None)
@given(cls=st.sampled_from(CLASSES), payload=st.binary(max_size=200))
def test_arbitrary_bytes_are_read_or_refused(cls: type[Message], payload: bytes) -> None:
    read_or_refuse(cls, payload)


@settings(deadline=None)
@given(cls=st.sampled_from(CLASSES), value=json_values)
def test_arbitrary_json_is_read_or_refused(cls: type[Message], value: Any) -> None:
    read_or_refuse(cls, json.dumps(value).encode())


@settings(deadline=None)
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


@settings(deadline=None)
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
scenes = st.builds(m.Scene, revision=st.integers(min_value=0), objects=st.lists(scene_objects, max_size=5).map(tuple))


@settings(deadline=None)
@given(message=st.one_of(trajectories(), poses, scenes))
def test_every_number_survives_the_wire_to_the_last_bit(message: Message) -> None:
    arrived = decode(type(message), encode(message))
    assert arrived == message
    assert encode(arrived) == encode(message)  # == takes -0.0 for 0.0; the bytes do not


@settings(deadline=None)
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
