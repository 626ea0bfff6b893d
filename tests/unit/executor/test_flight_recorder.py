"""Records of faults: the newest are kept, and whatever is wrong with the disk stays a warning."""

from __future__ import annotations

import logging
from pathlib import Path

import pytest

from support.harness import eventually
from zarm_contract.errors import Code, Problem
from zarm_contract.keys import Keys
from zarm_executor import flight_recorder
from zarm_executor.flight_recorder import KEPT, FlightRecorder
from zarm_executor.ring import Ring
from zarm_runtime.record import read_record

KEYS = Keys("arm")


def problem(code: Code = "driver_stalled") -> Problem:
    return Problem(code=code, message="see the driver")


@pytest.fixture
def ring() -> Ring:
    ring = Ring(KEYS)
    ring.observe(KEYS.joint_states, b"{}")
    return ring


def test_a_fault_is_written_before_the_end(ring: Ring, tmp_path: Path) -> None:
    with FlightRecorder(tmp_path / "records", KEYS, ring) as records:
        records.fault(problem("tolerance_violated"))
    (path,) = (tmp_path / "records").iterdir()
    assert path.name.endswith("Z_tolerance_violated.mcap")
    assert [(key, payload) for _, key, payload in read_record(path)] == [(KEYS.joint_states, b"{}")]


def test_the_newest_are_kept_and_drafts_of_a_killed_process_go(ring: Ring, tmp_path: Path) -> None:
    old = [tmp_path / f"20200101T000000.{k:06}Z_timeout.mcap" for k in range(KEPT + 5)]
    for path in (*old, tmp_path / "20200102T000000.000000Z_timeout.mcap.part"):
        path.write_bytes(b"")
    (tmp_path / "notes.txt").write_text("a person's")
    with FlightRecorder(tmp_path, KEYS, ring) as records:
        records.fault(problem())
    left = sorted(path.name for path in tmp_path.iterdir())
    assert left[: KEPT - 1] == [path.name for path in old[-KEPT + 1 :]]
    assert left[KEPT - 1].endswith("driver_stalled.mcap")
    assert left[KEPT:] == ["notes.txt"]


def test_of_faults_during_a_write_the_last_is_recorded(
    ring: Ring, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    codes: tuple[Code, ...] = ("timeout", "internal", "tolerance_violated")
    records = FlightRecorder(tmp_path, KEYS, ring)
    contents = ring.contents

    def storm() -> object:  # while the first record is written
        monkeypatch.setattr(ring, "contents", contents)
        for code in codes:
            records.fault(problem(code))
        return contents()

    monkeypatch.setattr(ring, "contents", storm)
    with records:
        records.fault(problem())
        eventually(lambda: len(list(tmp_path.glob("*.mcap"))) == 2, "both are written")
    assert [path.stem.split("Z_")[1] for path in sorted(tmp_path.glob("*.mcap"))] == ["driver_stalled", codes[-1]]


def test_where_nothing_can_be_written_a_warning_is_all(
    ring: Ring, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    taken = tmp_path / "records"
    taken.write_text("no folder")
    with caplog.at_level(logging.WARNING), FlightRecorder(taken, KEYS, ring) as records:
        records.fault(problem())
        eventually(lambda: caplog.records, "it is logged")
        assert records._thread.is_alive()
    assert "no record of the fault" in caplog.text
    assert taken.read_text() == "no folder"


def test_a_write_that_fails_half_way_leaves_nothing(
    ring: Ring, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def fail(self: object) -> None:
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patched, FlightRecorder(tmp_path, KEYS, ring) as records:
        patched.setattr(flight_recorder.RecordFile, "close", fail)
        records.fault(problem())
        eventually(lambda: "No space left on device" in caplog.text, "it is logged")
        patched.undo()
        assert list(tmp_path.iterdir()) == []
        records.fault(problem())
    assert len(list(tmp_path.iterdir())) == 1
