"""What outlives a process: read by every later version, never lost, and never shared by two."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from zarm_contract.errors import Unavailable
from zarm_contract.messages import Accepted, GoalState, JointState
from zarm_runtime.state_file import StateFile, owned, unchanged

POSITION = JointState(stamp=1.0, joint_names=("a",), position=(0.1,), velocity=(0.0,))
OLD = b'{"stamp":1.0,"joint_names":["a"],"position":[0.1],"velocity":[0.0]}'
"""What zarm 0.1.0 wrote before files stated a version."""


def file_in(folder: Path) -> StateFile[JointState]:
    return StateFile(folder / "robot.json", JointState)


def beside(folder: Path) -> dict[str, bytes]:
    return {file.name: file.read_bytes() for file in folder.iterdir()}


def test_a_file_states_its_version_and_who_wrote_it(tmp_path: Path) -> None:
    file_in(tmp_path).save(POSITION)
    document = json.loads((tmp_path / "robot.json").read_text())
    assert document == {"version": 1, "written_by": "0.1.0", "content": json.loads(OLD)}
    assert file_in(tmp_path).load() == POSITION
    assert list(beside(tmp_path)) == ["robot.json"]


def test_a_file_without_a_version_is_taken_over_and_kept(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level("INFO")
    (tmp_path / "robot.json").write_bytes(OLD)
    assert file_in(tmp_path).load() == POSITION
    assert beside(tmp_path)["robot.json.v0"] == OLD
    assert "from=0 to=1" in caplog.text
    assert "robot.json.v0" in caplog.text
    assert file_in(tmp_path).load() == POSITION
    assert sorted(beside(tmp_path)) == ["robot.json", "robot.json.v0"]


def test_a_goal_that_an_older_zarm_left_running_is_taken_over(tmp_path: Path) -> None:
    (tmp_path / "goal.json").write_text(
        '{"goal_id":"g","status":"running","progress":0.5,"elapsed":1.0,"duration":2.0,"joint_command":[0.1]}'
    )
    goal = StateFile(tmp_path / "goal.json", GoalState).load()
    assert goal is not None
    assert (goal.goal_id, goal.progress) == ("g", 0.5)


def test_each_version_leads_to_the_next(tmp_path: Path) -> None:
    steps = (lambda old: {"name": old["id"]}, lambda old: {"goal_id": old["name"]})
    (tmp_path / "a.json").write_text('{"id": "g"}')
    (tmp_path / "b.json").write_text('{"version": 1, "content": {"name": "g"}}')
    (tmp_path / "c.json").write_text('{"version": 2, "content": {"goal_id": "g"}}')
    for name, kept in (("a", ["a.json.v0"]), ("b", ["b.json.v1"]), ("c", [])):
        assert StateFile(tmp_path / f"{name}.json", Accepted, migrations=steps).load() == Accepted(goal_id="g")
        assert [file.name for file in tmp_path.glob(f"{name}.json.*")] == kept


def test_the_file_of_a_newer_zarm_is_refused_and_left_as_it_is(tmp_path: Path) -> None:
    StateFile(tmp_path / "robot.json", JointState, migrations=(unchanged,) * 3).save(POSITION)
    before = beside(tmp_path)
    with pytest.raises(Unavailable, match=r"version 3, written by zarm 0\.1\.0.* up to 1; run that version"):
        file_in(tmp_path).load()
    assert beside(tmp_path) == before


@pytest.mark.parametrize(
    "content", [b"", b"[]", b"7", b"\xff", b"[" * 10**5, b'{"version": 1}', b'{"version": "x"}', OLD[:20], b"{}"]
)
def test_what_cannot_be_read_is_put_aside_each_time_and_said(
    tmp_path: Path, content: bytes, caplog: pytest.LogCaptureFixture
) -> None:
    for name in ("robot.json.broken", "robot.json.broken.2"):
        (tmp_path / "robot.json").write_bytes(content)
        file = file_in(tmp_path)
        assert file.load() is None
        assert file.broken == tmp_path / name
        assert name in caplog.text
        assert beside(tmp_path)[name] == content
        file.save(POSITION)
        assert file.broken is None


def test_a_state_folder_belongs_to_one_live_process(tmp_path: Path) -> None:
    hold = (
        "import sys, pathlib, time; from zarm_runtime.state_file import owned\n"
        "with owned(pathlib.Path(sys.argv[1]), 'executor'): print('held', flush=True); time.sleep(600)"
    )
    with subprocess.Popen([sys.executable, "-c", hold, str(tmp_path)], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "held\n"
        with (
            pytest.raises(Unavailable, match=r"another executor keeps its state in .*--name"),
            owned(tmp_path, "executor"),
        ):
            pass
        with owned(tmp_path, "planner"):
            pass
        process.send_signal(signal.SIGKILL)
    with owned(tmp_path, "executor") as folder:
        assert folder == tmp_path
