"""A fault leaves a record of the minute that led to it, and a record that cannot be written changes nothing else."""

from __future__ import annotations

import json
import resource
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from support.command_line import zarm
from support.executor.driven import FAR, Driven, driven
from support.harness import eventually
from support.trajectories import KEYS, rest_to_rest
from zarm_contract.codec import encode
from zarm_contract.messages import DriverFault
from zarm_runtime.bus import Bus
from zarm_runtime.record import Entry, read_record

SLOWLY = rest_to_rest(FAR, slower=4.0)
"""So slow that an executor beside other work is not behind it by what makes a fault."""


@pytest.fixture
def moving(bus: Bus, endpoint: str, tmp_path: Path) -> Iterator[Driven]:
    with driven(bus, endpoint, tmp_path, "joint_speed") as robot:
        robot.client.under_way(robot.client.execute(SLOWLY))
        yield robot


def records(robot: Driven) -> list[Path]:
    return sorted((robot.folder / KEYS.robot / "records").glob("*.mcap"))


def written(robot: Driven, count: int = 1) -> Path:
    """The newest record, once there are so many."""
    return eventually(lambda: records(robot)[count - 1 :], f"{count} records are written")[-1]


def of(entries: list[Entry], key: str) -> list[bytes]:
    return [payload for _, on, payload in entries if on == key]


def test_a_fault_leaves_a_record_of_all_that_led_to_it(moving: Driven) -> None:
    moving.set_fault(DriverFault(stall=True))
    fault = moving.fault("tolerance_violated")
    path = written(moving)
    assert path.name.endswith("Z_tolerance_violated.mcap")
    eventually(lambda: f"record path={path}" in moving.executor.output(), "its path is logged")
    entries = list(read_record(path))

    assert of(entries, KEYS.executor_state)[-1] == encode(fault)
    goal_id = moving.client.goals[-1].goal_id
    statuses = [json.loads(payload)["status"] for payload in of(entries, KEYS.goal(goal_id))]
    assert statuses[0] == "accepted"
    assert statuses[-1] == "aborted"

    sent, heard = of(entries, KEYS.driver_command), list(map(encode, moving.commands))
    assert sent[: len(heard)] == heard[: len(sent)]  # from the first to the last of the motion, as the driver got them
    assert len(sent) > 10

    measured = of(entries, KEYS.joint_states)
    reported = of(entries, KEYS.driver_joint_states)
    assert {encode(state) for state in moving.client.measured} & set(measured)
    assert {encode(state) for state in moving.reported} & set(reported)
    first, last = (np.array(json.loads(payload)["position"]) for payload in (measured[0], measured[-1]))
    assert np.max(np.abs(last - first)) > 0.05  # the motion is in it, not only its end

    story = zarm("replay", str(path))
    assert story.returncode == 0, story.stderr
    for part in (goal_id, "aborted", "tolerance_violated", "furthest off", "fault"):
        assert part in story.stdout


@pytest.mark.slow
def test_every_fault_has_a_record_of_its_own(moving: Driven) -> None:
    moving.set_fault(DriverFault(stall=True))
    moving.fault("tolerance_violated")
    written(moving)
    moving.set_fault(DriverFault())
    moving.works_again()
    moving.client.under_way(moving.client.execute(SLOWLY))
    moving.set_fault(DriverFault(silent=True))
    moving.fault("driver_stalled")
    assert written(moving, 2).name.endswith("driver_stalled.mcap")


@pytest.mark.slow
def test_an_unwritable_record_is_a_warning_and_nothing_else(moving: Driven) -> None:
    (moving.folder / KEYS.robot / "records").write_text("a file where the folder is to be")
    moving.set_fault(DriverFault(stall=True))
    moving.fault("tolerance_violated")
    eventually(lambda: "no record of the fault" in moving.executor.output(), "the warning is logged")
    moving.set_fault(DriverFault())
    moving.works_again()


@pytest.mark.slow
def test_a_fault_is_on_record_even_if_the_executor_ends_at_once(moving: Driven) -> None:
    moving.set_fault(DriverFault(stall=True))
    moving.fault("tolerance_violated")
    moving.executor.process.terminate()
    moving.executor.process.wait()
    assert list(read_record(written(moving)))


@pytest.mark.slow
def test_a_disk_that_fills_leaves_no_partial_record(moving: Driven) -> None:
    pid = moving.executor.process.pid
    _, hard = resource.prlimit(pid, resource.RLIMIT_FSIZE)
    resource.prlimit(pid, resource.RLIMIT_FSIZE, (20_000, hard))
    moving.set_fault(DriverFault(stall=True))
    moving.fault("tolerance_violated")
    eventually(lambda: "no record of the fault" in moving.executor.output(), "the warning is logged")
    assert list((moving.folder / KEYS.robot / "records").iterdir()) == []
    moving.set_fault(DriverFault())
    moving.works_again()
