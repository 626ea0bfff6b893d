"""Every message class is walked: it survives the wire, its wire format is held, and what breaks a rule is refused."""

from __future__ import annotations

import copy
import json
from collections.abc import Iterator
from typing import Any, get_args

import pytest
from pydantic import ValidationError

from support.message_examples import EXAMPLES, GOLDEN, by_class, golden_text
from zarm_contract import messages
from zarm_contract.codec import MAX_BYTES, decode, encode, schema
from zarm_contract.errors import InvalidRequest, Problem
from zarm_contract.messages import Health, Message

CLASSES = sorted(
    {cls for cls in vars(messages).values() if isinstance(cls, type) and issubclass(cls, Message)} - {Message}
    | {Problem},
    key=lambda cls: cls.__name__,
)
Path = tuple[int | str, ...]


def every_class(function: Any) -> Any:
    return pytest.mark.parametrize("cls", CLASSES, ids=lambda cls: cls.__name__)(function)


def every_example(function: Any) -> Any:
    names = [f"{type(example).__name__}-{index}" for index, example in enumerate(EXAMPLES)]
    return pytest.mark.parametrize("example", EXAMPLES, ids=names)(function)


def leaves(data: Any, path: Path = ()) -> Iterator[tuple[Path, Any]]:
    """Every number, string and boolean of a payload, with its path."""
    if isinstance(data, dict | list):
        for key, value in data.items() if isinstance(data, dict) else enumerate(data):
            yield from leaves(value, (*path, key))
    else:
        yield path, data


def objects(data: Any, path: Path = ()) -> Iterator[Path]:
    """The path of every JSON object of a payload."""
    if isinstance(data, dict):
        yield path
    if isinstance(data, dict | list):
        for key, value in data.items() if isinstance(data, dict) else enumerate(data):
            yield from objects(value, (*path, key))


def changed(data: Any, path: Path, value: Any) -> bytes:
    """The payload with another value at `path`."""
    data = copy.deepcopy(data)
    place = data
    for part in path[:-1]:
        place = place[part]
    place[path[-1]] = value
    return json.dumps(data).encode()


def refused_field(cls: type[Message], payload: bytes) -> str | None:
    """The field that the refusal of `payload` names."""
    with pytest.raises(InvalidRequest) as refusal:
        decode(cls, payload)
    assert refusal.value.problem.message.startswith(f"{cls.__name__}: ")
    return refusal.value.problem.field


def dotted(path: Path) -> str:
    return ".".join(map(str, path))


# -- the examples are complete --


def test_every_message_class_of_the_contract_has_an_example() -> None:
    assert set(by_class()) == set(CLASSES)


@every_class
def test_the_examples_set_every_field(cls: type[Message]) -> None:
    assert set().union(*(example.model_fields_set for example in by_class()[cls])) == set(cls.model_fields)


# -- the wire --


@every_example
def test_an_example_survives_the_wire_unchanged(example: Message) -> None:
    assert decode(type(example), encode(example)) == example
    assert encode(decode(type(example), encode(example))) == encode(example)


@every_class
def test_a_message_survives_the_wire_with_defaults(cls: type[Message]) -> None:
    required = {name for name, field in cls.model_fields.items() if field.is_required()}
    for example in by_class()[cls]:
        bare = cls.model_validate_json(example.model_dump_json(include=required))
        assert decode(cls, encode(bare)) == bare


@every_class
def test_what_may_be_null_may_be_left_out(cls: type[Message]) -> None:
    """None is not sent, so whoever reads must do without."""
    data = json.loads(encode(by_class()[cls][0]))
    for name, field in cls.model_fields.items():
        if type(None) in get_args(field.annotation):
            message = decode(cls, changed(data, (name,), None))
            assert decode(cls, encode(message)) == message


@every_class
def test_the_wire_format_is_that_of_the_golden_file(cls: type[Message]) -> None:
    """A change is a change of the contract: if it is meant, run `python tests/support/message_examples.py`."""
    assert golden_text(by_class()[cls]) == (GOLDEN / f"{cls.__name__}.json").read_text()


@every_class
def test_the_golden_file_is_read_back_as_the_examples(cls: type[Message]) -> None:
    payloads = json.loads((GOLDEN / f"{cls.__name__}.json").read_text())
    assert tuple(decode(cls, json.dumps(payload).encode()) for payload in payloads) == by_class()[cls]


def test_there_is_no_golden_file_without_a_class() -> None:
    assert {file.stem for file in GOLDEN.iterdir()} == {cls.__name__ for cls in CLASSES}


@every_class
def test_the_schema_name_carries_class_and_version(cls: type[Message]) -> None:
    assert schema(cls) == f"zarm.{cls.__name__}.v4"


@every_example
def test_a_message_cannot_be_changed(example: Message) -> None:
    for name in type(example).model_fields:
        with pytest.raises(ValidationError):
            setattr(example, name, getattr(example, name))


# -- strictness --


@every_example
def test_nan_and_infinity_are_refused_by_field(example: Message) -> None:
    data = json.loads(encode(example))
    for path, value in leaves(data):
        if isinstance(value, float):
            for unreal in (float("nan"), float("inf"), -float("inf")):
                assert refused_field(type(example), changed(data, path, unreal)) == dotted(path)


@every_example
def test_a_value_of_another_type_is_refused_by_field(example: Message) -> None:
    data = json.loads(encode(example))
    for path, value in leaves(data):
        # the tag of a union tells which rules apply, so a wrong one is a fault of the whole member
        inside = path[-1] in ("kind", "op") and len(path) > 1
        field = dotted(path[:-1] if inside else path)
        wrong: list[Any] = [[], {}]
        wrong += [-1 if value == "free" else 7, True] if isinstance(value, str) else ["7"]  # `free` stands for a number
        wrong += [1, 0.5] if isinstance(value, bool) else []
        wrong += [True] if isinstance(value, float | int) and not isinstance(value, bool) else []
        wrong += [1.5] if isinstance(value, int) and not isinstance(value, bool) else []
        for other in wrong:
            if other is None and path[-1] in type(example).model_fields and len(path) == 1:
                continue  # null stands for an optional field that is left out
            assert refused_field(type(example), changed(data, path, other)) == field


@every_example
def test_unknown_fields_are_refused_except_across_versions(
    example: Message,
) -> None:
    data = json.loads(encode(example))
    for path in objects(data):
        payload = changed(data, (*path, "surprise"), 1)
        if isinstance(example, Health):
            assert decode(Health, payload) == example
            continue
        assert refused_field(type(example), payload) == dotted((*path, "surprise"))


@every_class
def test_a_missing_field_is_refused_by_name(cls: type[Message]) -> None:
    data = json.loads(encode(by_class()[cls][0]))
    for name, field in cls.model_fields.items():
        if field.is_required():
            payload = json.dumps({key: value for key, value in data.items() if key != name})
            assert refused_field(cls, payload.encode()) == name


@every_class
def test_a_payload_over_the_limit_is_refused_before_it_is_read(cls: type[Message]) -> None:
    with pytest.raises(InvalidRequest, match="send less") as refusal:
        decode(cls, b" " * (MAX_BYTES + 1))
    assert refusal.value.problem.field == "payload"


_JOINTS_33 = [0.0] * 33
_POSES_1001 = [{"position": [0.0, 0.0, 0.0]}] * 1001
_NAME_65 = "n" * 65
_BALL = {"kind": "sphere", "name": "ball", "position": [0.0, 0.0, 0.0], "radius": 0.1}
_BALLS_10001 = [_BALL] * (messages.MAX_OBJECTS + 1)


@pytest.mark.parametrize(
    ("cls", "path", "value"),
    [
        (messages.JointGoal, ("position",), _JOINTS_33),
        (messages.JointGoal, ("position",), []),
        (messages.PlanRequest, ("start",), _JOINTS_33),
        (messages.PlanRequest, ("timeout",), 60.1),
        (messages.PlanRequest, ("timeout",), 0.0),
        (messages.PlanRequest, ("velocity_scale",), 1.01),
        (messages.PlanRequest, ("acceleration_scale",), 0.0),
        (messages.PlanRequest, ("seed",), 2**32),
        (messages.PlanRequest, ("request_id",), _NAME_65),
        (messages.PlanRequest, ("request_id",), "a/b"),
        (messages.PlanRequest, ("request_id",), ""),
        (messages.Plan, ("scene_revision",), 3),
        (messages.Plan, ("scene_revision",), "3"),
        (messages.Plan, ("scene_revision",), "-1-5be0c1d2f3a4"),
        (messages.Plan, ("scene_revision",), "03-5be0c1d2f3a4"),
        (messages.Plan, ("scene_revision",), "3-5be0c1d2f3a4\n"),
        (messages.CancelPlan, ("request_id",), "*"),
        (messages.IkRequest, ("poses",), _POSES_1001),
        (messages.IkRequest, ("poses",), []),
        (messages.IkRequest, ("max_solutions",), 65),
        (messages.FkRequest, ("joints",), [[0.0]] * 1001),
        (messages.FkRequest, ("joints",), []),
        (messages.CheckRequest, ("joints",), [[0.0]] * 1001),
        (messages.PlannerSettings, ("margin",), 0.21),
        (messages.SettingsChange, ("margin",), -0.01),
        (messages.Sphere, ("name",), _NAME_65),
        (messages.Sphere, ("radius",), 0.0),
        (messages.Cuboid, ("size", 2), -1.0),
        (messages.Capsule, ("length",), 0.0),
        (messages.Cylinder, ("radius",), -0.1),
        (messages.Scene, ("objects",), _BALLS_10001),
        (messages.AddObjects, ("objects",), _BALLS_10001),
        (messages.AddObjects, ("objects",), []),
        (messages.LoadScene, ("objects",), _BALLS_10001),
        (messages.RemoveObjects, ("names",), []),
        (messages.GoalState, ("progress",), 1.1),
        (messages.GoalState, ("joint_command",), _JOINTS_33),
        (messages.JointState, ("joint_names",), [f"joint_{i}" for i in range(33)]),
        (messages.ExecutorState, ("missed_ticks",), -1),
        (messages.Accepted, ("goal_id",), _NAME_65),
        (messages.StrategyRequest, ("strategy",), _NAME_65),
        (messages.Health, ("pid",), 0),
        (messages.Health, ("uptime",), -0.1),
    ],
)
def test_a_value_out_of_range_is_refused_by_field(cls: type[Message], path: Path, value: Any) -> None:
    data = json.loads(encode(by_class()[cls][0]))
    assert refused_field(cls, changed(data, path, value)) == dotted(path)


# -- rules over several fields --


@pytest.mark.parametrize("orientation", [(0.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.01), (1e200, 0.0, 0.0, 1.0)])
def test_a_quaternion_that_is_no_rotation_is_refused(orientation: tuple[float, float, float, float]) -> None:
    payload = json.dumps({"position": [0.0, 0.0, 0.0], "orientation": orientation}).encode()
    assert refused_field(messages.Pose, payload) == "orientation"


def test_a_nearly_normalised_quaternion_is_normalised() -> None:
    pose = messages.Pose(position=(0.0, 0.0, 0.0), orientation=(0.0, 0.0, 0.7071, 0.7071))
    assert sum(x * x for x in pose.orientation) == pytest.approx(1.0, abs=1e-15)


@pytest.mark.parametrize(
    ("path", "value"),
    [
        (("time",), [0.1, 0.5, 1.25]),  # does not start at 0
        (("time",), [0.0, 0.5, 0.5]),  # stands still
        (("time",), [0.0, 0.5, 0.4]),  # runs backwards
        (("time",), [0.0]),  # no motion
        (("position",), [[0.0, 0.0], [0.1, 0.1]]),  # a row is missing
        (("velocity",), [[0.0, 0.0], [0.1], [0.0, 0.0]]),  # a joint is missing
        (("acceleration",), [[0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0]]),  # a joint too many
        (("joint_names",), ["elbow", "elbow"]),
        (("joint_names",), []),
    ],
)
def test_a_trajectory_of_unequal_columns_is_refused_by_field(path: Path, value: Any) -> None:
    (example,) = by_class()[messages.Trajectory]
    assert refused_field(messages.Trajectory, changed(json.loads(encode(example)), path, value)) == dotted(path)


@pytest.mark.parametrize("field", ["position", "velocity", "effort"])
def test_a_joint_state_with_a_joint_missing_is_refused_by_field(field: str) -> None:
    (example,) = by_class()[messages.JointState]
    assert refused_field(messages.JointState, changed(json.loads(encode(example)), (field,), [0.1])) == field


def test_an_execute_request_has_one_source_of_its_motion() -> None:
    by_plan, by_trajectory, going_on = (json.loads(encode(example)) for example in by_class()[messages.ExecuteRequest])
    both = json.dumps(by_trajectory | by_plan).encode()
    assert refused_field(messages.ExecuteRequest, both) == "trajectory"
    revised_plan = json.dumps(by_plan | {"scene_revision": "3-5be0c1d2f3a4"}).encode()
    assert refused_field(messages.ExecuteRequest, revised_plan) == "scene_revision"
    renamed = json.dumps(going_on | {"goal_id": "goal-2"}).encode()
    assert refused_field(messages.ExecuteRequest, renamed) == "continues"


def test_a_goal_state_says_whether_it_is_the_last() -> None:
    (example,) = by_class()[messages.GoalState]
    states = [example.model_copy(update={"status": status}) for status in get_args(messages.GoalStatus)]
    assert {state.status for state in states if state.done} == {"succeeded", "cancelled", "aborted"}
