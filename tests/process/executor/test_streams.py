"""Closed-loop chunks on `executor/stream`, from real clients over a real router."""

from __future__ import annotations

import itertools
import signal
import subprocess
import sys
import uuid
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from support.executor.client import Client
from support.executor.driven import LIMIT, driven
from support.executor.waves import as_message, chunk
from support.harness import PATIENCE, ServiceProcess, eventually
from support.paths import EXAMPLES
from support.tiers import sampled
from support.trajectories import HOME, KEYS, ROBOT, SCENE, moved, rest_to_rest
from zarm_contract.errors import ExecutionRefused
from zarm_contract.messages import GoalState, SceneEdited, StreamChunk
from zarm_runtime.bus import Bus
from zarm_runtime.session import open_client
from zarm_trajectory.trajectory import TimedTrajectory

EXAMPLE = EXAMPLES / "stream_client.py"


def run_example(endpoint: str, seconds: float) -> subprocess.Popen[bytes]:
    command = [sys.executable, str(EXAMPLE), "--connect", endpoint, "--seconds", str(seconds)]
    command += ["--deadline", "1"]  # on a busy machine the client may have to wait for its turn
    return subprocess.Popen([*command, "--joints", *ROBOT.descriptor.joints])


def sender(client: Client) -> Callable[..., None]:
    """Sends one chunk; the publisher is known to the executor."""
    publisher = client.bus.publisher(KEYS.stream)

    def put(
        goal_id: str, sequence: int, start: float = 0.0, path: TimedTrajectory | None = None, **others: object
    ) -> None:
        trajectory = as_message(chunk(start) if path is None else path, ROBOT)
        publisher.put(
            StreamChunk.model_validate(
                {"goal_id": goal_id, "sequence": sequence, "start": start, "trajectory": trajectory} | others
            )
        )

    return put


@pytest.fixture
def send(client: Client) -> Callable[..., None]:
    return sender(client)


def seen(client: Client, goal_id: str) -> GoalState:
    """Wait for the end of a goal that may not be known yet."""

    def end() -> GoalState | None:
        return next((goal for goal in client.goals if goal.goal_id == goal_id and goal.done), None)

    return eventually(end, f"{goal_id} has ended")


@pytest.mark.slow
def test_the_example_of_a_client_is_followed_to_its_end(client: Client, endpoint: str) -> None:
    process = run_example(endpoint, 3.0)
    assert process.wait(PATIENCE) == 0
    assert {goal.status for goal in client.goals if goal.done} == {"succeeded"}
    swing = np.array([joints.position[0] for joints in client.measured])
    assert swing.max() - HOME[0] == pytest.approx(0.3, abs=0.01)
    assert client.greatest_acceleration() <= 1.03
    assert client.stands()


def test_a_held_stream_resumes_with_a_chunk_after_the_scene_edit(client: Client, endpoint: str) -> None:
    scene, edits = client.bus.latched(KEYS.scene_revision), itertools.count(2)
    scene.set(SceneEdited(revision=SCENE, count=0))
    process = run_example(endpoint, 60.0)

    def edit_is_known() -> bool:
        if not client.state().scene_changed:  # a chunk that was still under way came after the last edit
            scene.set(SceneEdited(revision=f"{next(edits)}-0123456789ab", count=1))
        return client.state().scene_changed

    try:
        eventually(lambda: client.state().mode == "running", "the stream runs")
        client.command(KEYS.pause)
        client.mode("paused")
        process.send_signal(signal.SIGSTOP)
        eventually(edit_is_known, "the edit is known")
        with pytest.raises(ExecutionRefused) as refusal:
            client.command(KEYS.resume)
        assert refusal.value.code == "stale_plan"
        assert client.stands()
        process.send_signal(signal.SIGCONT)
        eventually(lambda: not client.state().scene_changed, "a chunk has come")
        assert client.command(KEYS.resume).mode == "running"
    finally:
        process.kill()
        process.wait()


@pytest.mark.slow  # as when it dies
def test_a_frozen_client_leaves_the_robot_idle(client: Client, endpoint: str) -> None:
    process = run_example(endpoint, 60.0)
    try:
        eventually(lambda: client.state().mode == "running", "the stream runs")
        eventually(lambda: abs(client.measured[-1].velocity[0]) > 0.15, "the robot moves")
        process.send_signal(signal.SIGSTOP)
        goal_id = client.state().goal_id
        assert goal_id is not None
        end = seen(client, goal_id)
        assert (end.status, end.problem.code) == ("aborted", "timeout")
        assert client.statuses(goal_id)[-2:] == ["stopping", "aborted"]
        rested = client.position()
        assert client.state().mode == "idle"
        process.send_signal(signal.SIGCONT)
        process.wait(PATIENCE)  # what it still sends is late
        assert client.stands()
        np.testing.assert_array_equal(client.position(), rested)
        assert client.greatest_acceleration() <= 1.03
        assert client.ended(client.execute(rest_to_rest(HOME, rested))).status == "succeeded"
    finally:
        process.kill()
        process.wait()


def test_example_is_short() -> None:
    assert len(EXAMPLE.read_text().splitlines()) < 100


@pytest.mark.parametrize(
    ("chunks", "code"),
    [
        ([(1, 0.0, chunk(0.0, off=0.5))], "start_state_mismatch"),
        (
            [(1, 0.0, TimedTrajectory.of(rest_to_rest(moved(1.0), slower=0.7), ROBOT.descriptor.joints))],
            "limit_violated",
        ),
        ([(1, 0.3, chunk(0.0))], "invalid_request"),
        ([(1, 0.0, chunk(0.0)), (2, 0.0, chunk(0.0, off=0.9))], "limit_violated"),
        ([(1, 0.0, chunk(0.0)), (1, 0.0, chunk(0.0)), (3, 0.0, chunk(0.0)), (2, 0.0, chunk(0.0, off=0.9))], "timeout"),
    ],
    ids=["starts elsewhere", "too fast", "starts late", "out of reach", "out of order, and no more"],
)
def test_the_outcome_of_a_stream_is_in_its_goal_and_no_fault(
    shared: Client, chunks: list[tuple[int, float, TimedTrajectory]], code: str
) -> None:
    send, goal_id = sender(shared), f"stream-{uuid.uuid4().hex}"
    for sequence, start, path in chunks:
        send(goal_id, sequence, start, path)
    end = seen(shared, goal_id)
    assert (end.status, end.problem.code) == ("aborted", code)
    assert shared.state().mode == "idle"
    assert shared.stands()
    assert shared.ended(shared.execute(rest_to_rest(HOME, shared.position()))).status == "succeeded"


@pytest.mark.slow  # as in unit/executor/test_streams.py
def test_a_stream_beside_another_goal_is_refused(client: Client, send: Callable[..., None]) -> None:
    goal_id = client.execute(rest_to_rest(moved(1.0)))
    client.under_way(goal_id, 0.1)
    send("stream-b", 1)
    send(goal_id, 1)
    send(goal_id, 2)
    assert seen(client, "stream-b").problem.code == "busy"
    assert client.ended(goal_id).status == "succeeded"


def test_noise_and_chunks_of_unknown_streams_do_no_harm(
    executor: ServiceProcess, client: Client, send: Callable[..., None], endpoint: str
) -> None:
    with open_client(endpoint) as session:
        for payload in (b"{", b"\xff", b"", b"[" * 100_000, b'{"goal_id": "x", "sequence": 0}') * 20:
            session.put(KEYS.stream, payload)
    for sequence in range(2, 30):
        send("stream-c", sequence)
    send("stream-d", 1, last=True)
    assert seen(client, "stream-d").status == "succeeded"
    assert executor.output().count("goal_id=stream-c") == 1
    assert not [goal for goal in client.goals if goal.goal_id == "stream-c"]


@pytest.mark.parametrize("strategy", sampled("joint_speed", "joint_pose"))
def test_a_driver_follows_a_stream_and_outlives_its_client(
    bus: Bus, endpoint: str, tmp_path: Path, strategy: str
) -> None:
    plays = ("--plays", "position") if strategy == "joint_pose" else ()
    with driven(bus, endpoint, tmp_path, strategy, *plays) as robot:
        process = run_example(endpoint, 60.0)
        try:
            eventually(lambda: robot.reported and abs(robot.arm()[0] - HOME[0]) > 0.2, "the arm follows")
        finally:
            process.kill()
            process.wait()
        robot.client.mode("idle")
        assert robot.client.goals[-1].problem.code == "timeout"
        robot.at_rest()
        if strategy == "joint_speed":
            assert robot.commanded_acceleration() <= LIMIT * 1.01


def test_joint_trajectory_takes_no_stream(bus: Bus, endpoint: str, tmp_path: Path) -> None:
    with driven(bus, endpoint, tmp_path, "joint_trajectory") as robot:
        process = run_example(endpoint, 5.0)
        assert process.wait(PATIENCE) == 1
        refused = robot.client.goals[-1]
        assert (refused.status, refused.problem.code) == ("aborted", "unavailable")
        assert "switch to another strategy" in refused.problem.message
        assert not any(command.time for command in robot.commands)
