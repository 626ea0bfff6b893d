"""A record holds the very messages of the bus, whole or not at all, in words that its viewers know."""

from __future__ import annotations

import resource
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given
from hypothesis import strategies as st
from mcap.reader import make_reader

from support.examples import examples
from zarm_contract.codec import decode, encode, schema
from zarm_contract.errors import InvalidRequest
from zarm_contract.keys import Keys
from zarm_contract.messages import JointState
from zarm_runtime.record import Entry, RecordFile, plain_schema, read_record
from zarm_runtime.recorded import Recorded

KEYS = Keys("arm")
RECORDED = Recorded(KEYS)

numbers = st.floats(allow_nan=False, allow_infinity=False)
joint_states = st.integers(1, 8).flatmap(
    lambda width: st.builds(
        JointState,
        stamp=numbers,
        joint_names=st.just(tuple(f"j{k}" for k in range(width))),
        position=st.tuples(*[numbers] * width),
        velocity=st.tuples(*[numbers] * width),
    )
)
keys = st.sampled_from([key.replace("*", "goal-1") for key in RECORDED.keys])
entries = st.tuples(st.integers(0, 2**62), keys, st.binary(max_size=400))


def write(path: Path, content: list[Entry]) -> Path:
    file = RecordFile(path, KEYS)
    for entry in content:
        file.write(entry)
    file.close()
    return path


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "records" / "one.mcap"


@examples(0.5, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(content=st.lists(entries, max_size=20))
def test_a_record_is_read_back_in_order_of_time(path: Path, content: list[Entry]) -> None:
    assert list(read_record(write(path, content))) == sorted(content, key=lambda entry: entry[0])


@examples(0.5, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(states=st.lists(joint_states, min_size=1, max_size=5))
def test_messages_that_are_written_are_read_back_equal(path: Path, states: list[JointState]) -> None:
    write(path, [(at, KEYS.joint_states, encode(state)) for at, state in enumerate(states)])
    assert [decode(JointState, payload) for _, _, payload in read_record(path)] == states


def test_a_record_has_channels_schemas_statistics_and_an_index(path: Path) -> None:
    goals = [KEYS.goal("goal-1"), KEYS.goal("goal-2")]
    others = [key for key in RECORDED.keys if "*" not in key]
    write(path, [(at, key, b"{}") for at, key in enumerate(goals + others)])
    with path.open("rb") as stream:
        summary = make_reader(stream, validate_crcs=True).get_summary()
    assert {channel.topic for channel in summary.channels.values()} == {*goals, *others}
    assert {channel.message_encoding for channel in summary.channels.values()} == {"json"}
    for channel in summary.channels.values():
        described = summary.schemas[channel.schema_id]
        assert described.encoding == "jsonschema"
        assert described.name == schema(RECORDED.model(channel.topic))
    assert summary.statistics.message_count == len(goals + others)
    assert summary.chunk_indexes
    assert all(index.message_index_offsets for index in summary.chunk_indexes)


@pytest.mark.parametrize("model", sorted({key.model for key in RECORDED.keys.values()}, key=schema), ids=schema)
def test_foxglove_reads_the_schema_of_every_recorded_class(model: type) -> None:
    def readable(node: dict[str, Any]) -> None:  # as parseJsonSchema of foxglove/studio has it
        for name, field in node["properties"].items():
            assert field["type"] in ("boolean", "string", "number", "integer", "object", "array"), name
            inner = field["items"] if field["type"] == "array" else field
            assert inner["type"] in ("boolean", "string", "number", "integer", "object"), name
            if inner["type"] == "object":
                readable(inner)

    whole = plain_schema(model)
    assert whole["type"] == "object"
    assert set(whole["required"]) <= set(whole["properties"])
    assert whole["properties"]
    readable(whole)


def test_what_is_not_recorded_is_not_written(path: Path) -> None:
    file = RecordFile(path, KEYS)
    with pytest.raises(ValueError, match="preview"):
        file.write((1, KEYS.preview_joint_states, b"{}"))
    file.abandon()
    assert not path.exists()


def test_a_record_appears_when_it_is_whole(path: Path) -> None:
    file = RecordFile(path, KEYS)
    file.write((1, KEYS.joint_states, b"{}"))
    assert not path.exists()
    file.close()
    assert [each.name for each in path.parent.iterdir()] == [path.name]


def test_earlier_values_keep_their_time_of_publication(path: Path) -> None:
    file = RecordFile(path, KEYS)
    file.write((5, KEYS.executor_state, b"{}"), published=2)
    file.close()
    with path.open("rb") as stream:
        ((_, _, message),) = make_reader(stream).iter_messages()
    assert (message.log_time, message.publish_time) == (5, 2)


_FULL_DISK = """
import os, sys
from pathlib import Path
from zarm_contract.keys import Keys
from zarm_runtime.record import RecordFile
file = RecordFile(Path(sys.argv[1]), Keys("arm"))
try:
    for at in range(200):
        file.write((at, Keys("arm").joint_states, os.urandom(20_000)))
    file.close()
except OSError as error:
    file.abandon()
    print("refused", error.errno)
"""


def test_a_full_disk_is_an_oserror_and_leaves_no_record(path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-c", _FULL_DISK, str(path)],
        capture_output=True,
        text=True,
        check=True,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, 100_000)),
    )
    assert done.stdout.startswith("refused"), done.stderr
    assert done.stderr == ""
    assert not path.exists()


def test_a_key_that_is_damaged_in_the_summary_is_not_believed(path: Path) -> None:
    whole = write(path, [(at, KEYS.joint_states, b"%d" % at) for at in range(3)]).read_bytes()
    at = whole.rindex(b"zarm/")
    path.write_bytes(whole[:at] + b"{" + whole[at + 1 :])
    with pytest.raises(InvalidRequest, match="its summary is damaged"):
        list(read_record(path))


@examples(1, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_a_damaged_record_yields_only_what_was_written(path: Path, data: st.DataObject) -> None:
    content = [(at, KEYS.joint_states, b"%d" % at * 50) for at in range(50)]
    whole = write(path, content).read_bytes()
    at = data.draw(st.integers(0, len(whole) - 1))
    end = data.draw(st.one_of(st.just(len(whole)), st.integers(0, len(whole))))
    changed = bytearray(whole)
    changed[at] ^= data.draw(st.integers(1, 255))
    path.write_bytes(changed[:end])
    read: list[Entry] = []
    refused = None
    try:
        read.extend(read_record(path))
    except InvalidRequest as error:
        refused = str(error)
    assert set(read) <= set(content)
    assert refused is None or "one.mcap" in refused


def test_a_file_that_is_not_there_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InvalidRequest, match=r"none\.mcap"):
        list(read_record(tmp_path / "none.mcap"))


def test_a_record_of_another_contract_is_refused_with_the_remedy(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("zarm_contract.codec.CONTRACT", "v5")
    write(path, [(1, KEYS.joint_states, b"{}")])
    monkeypatch.undo()
    with pytest.raises(
        InvalidRequest, match="a record of contract v5, and this zarm reads v4; replay it with the zarm"
    ):
        list(read_record(path))
