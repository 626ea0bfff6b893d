"""`zarm record` and `zarm replay`, as a person uses them, beside a real executor."""

from __future__ import annotations

import json
import os
import resource
import signal
from base64 import b64decode, b64encode
from contextlib import ExitStack
from pathlib import Path

import pytest
from mcap.reader import make_reader

from support.command_line import Command, the_one_line, zarm
from support.executor.client import Client
from support.harness import ServiceProcess, eventually, free_endpoint
from support.tiers import sampled
from support.trajectories import KEYS, ROBOT, moved, rest_to_rest
from zarm_contract.codec import encode
from zarm_contract.image import encode_image
from zarm_contract.keys import Keys
from zarm_contract.messages import BodyPose, Cuboid, ImageHeader, PhysicsObjects, PhysicsState, Scene, Speed, VoxelBlock
from zarm_runtime.bus import Bus
from zarm_runtime.record import RecordFile, read_record
from zarm_runtime.session import open_router
from zarm_viewer.playback import Playback

OTHER = Keys("replayed")


def recording(endpoint: str, folder: Path, *arguments: str) -> Command:
    return Command("record", *arguments, "--name", KEYS.robot, folder=folder, ZARM_CONNECT=endpoint)


def begun(command: Command) -> None:
    """Wait until it records: it says so when it has subscribed to everything."""
    eventually(lambda: "Ctrl-C" in command.errors(), "it records")


@pytest.mark.parametrize("number", sampled(signal.SIGINT, signal.SIGTERM))
def test_a_motion_is_recorded_as_sent_and_summarised(
    client: Client, endpoint: str, tmp_path: Path, number: int
) -> None:
    file = tmp_path / "one.mcap"
    with recording(endpoint, tmp_path, str(file)) as command:
        begun(command)
        goal_id = client.execute(rest_to_rest(moved(0.3)))
        assert client.ended(goal_id).status == "succeeded"
        command.interrupt(number)
        assert command.end() == 0
        assert f"messages in {file}" in command.output()
    entries = list(read_record(file))
    reported = [payload for _, key, payload in entries if key == KEYS.goal(goal_id)]
    heard = [encode(goal) for goal in client.goals if goal.goal_id == goal_id]
    assert reported == heard
    measured = [payload for _, key, payload in entries if key == KEYS.joint_states]
    heard = [encode(state) for state in client.measured]
    # A busy machine drops a measured state on its way, for the record or for the client.
    both = set(measured) & set(heard)
    assert len(both) > len(measured) / 2
    assert [state for state in measured if state in both] == [state for state in heard if state in both]
    assert KEYS.strategy in {key for _, key, _ in entries}  # published last long before

    story = zarm("replay", str(file))
    assert story.returncode == 0, story.stderr
    for part in (KEYS.robot, goal_id, "running", "succeeded at 100%", "emulator", "furthest off"):
        assert part in story.stdout


def test_depth_images_are_on_record_if_they_are_asked_for(client: Client, endpoint: str, tmp_path: Path) -> None:
    file, stamp = tmp_path / "seen.mcap", 1.75e9 + 0.25
    header = ImageHeader(stamp=stamp, width=32, height=16, encoding="16UC1")
    pixels = bytes(range(256)) * 4
    with Bus(endpoint) as bus, recording(endpoint, tmp_path, str(file), "--images") as command:
        begun(command)
        images = bus.publisher(KEYS.depth("front"))
        images.put_encoded(b"no image")
        for _ in range(3):
            images.put_encoded(encode_image(header, pixels))
        goal_id = client.execute(rest_to_rest(moved(0.1)))
        assert client.ended(goal_id).status == "succeeded"
        command.interrupt()
        assert command.end() == 0
        assert "1 lost" in command.output()
    with file.open("rb") as stream:
        seen = [(described, json.loads(message.data)) for described, channel, message in make_reader(stream).iter_messages() if channel.topic == KEYS.depth("front")]  # fmt: skip
    assert len(seen) == 3
    described, image = seen[0]
    assert described is not None
    assert described.name == "foxglove.RawImage"
    assert image["timestamp"] == {"sec": 1_750_000_000, "nsec": 250_000_000}
    assert (image["width"], image["height"], image["encoding"], image["step"]) == (32, 16, "16UC1", 64)
    assert b64decode(image["data"]) == pixels
    story = zarm("replay", str(file))
    assert story.returncode == 0, story.stderr
    assert goal_id in story.stdout


def test_scene_map_and_simulation_are_recorded_on_request(client: Client, endpoint: str, tmp_path: Path) -> None:
    with_scene, without = tmp_path / "with.mcap", tmp_path / "without.mcap"
    box = Cuboid(kind="cuboid", name="box", size=(0.1, 0.1, 0.1), position=(0.5, 0.0, 0.05))
    block = VoxelBlock(position=(0.0, 0.0, 0.0), resolution=0.02, cells=b64encode(b"\x01" + bytes(511)).decode())
    body = BodyPose(name="box", position=(0.5, 0.0, 0.3), orientation=(0.0, 0.0, 0.0, 1.0))
    with ExitStack() as stack:
        bus = stack.enter_context(Bus(endpoint))
        bus.latched(KEYS.scene).set(Scene(revision="1-0123456789ab", objects=(box,)))  # as it was before
        commands = [
            stack.enter_context(recording(endpoint, tmp_path, str(with_scene), "--scene")),
            stack.enter_context(recording(endpoint, tmp_path, str(without))),
        ]
        for command in commands:
            begun(command)
        bus.latched(KEYS.voxels("0.0.0")).set(block)
        bus.latched(KEYS.physics_objects).set(PhysicsObjects(objects=(box,)))
        bus.publisher(KEYS.physics_state).put(
            PhysicsState(
                stamp=1.0,
                time=1.0,
                real_time_factor=1.0,
                position=(0.0,),
                velocity=(0.0,),
                effort=(0.0,),
                bodies=(body,),
            )
        )
        goal_id = client.execute(rest_to_rest(moved(0.1)))
        assert client.ended(goal_id).status == "succeeded"
        for command in commands:
            command.interrupt()
            assert command.end() == 0
    played = Playback(with_scene)
    played.pause()
    played.seek(played.story.lasted)
    news = played.take(ROBOT.descriptor.joints)
    assert news.scene is not None
    assert news.scene.objects == (box,)
    assert news.voxels is not None
    assert [len(one.cells) for one in news.voxels.values()] == [1]
    assert news.simulated == PhysicsObjects(objects=(box,))
    assert news.physics is not None
    assert news.physics.bodies == (body,)
    played.seek(0.0)
    assert played.take(ROBOT.descriptor.joints).voxels == {}, "before the map came there was none"
    assert not {KEYS.scene, KEYS.physics_state} & {key for _, key, _ in read_record(without)}
    assert zarm("replay", str(with_scene)).returncode == 0


def test_a_record_ends_after_the_seconds_that_were_asked_for(client: Client, endpoint: str, tmp_path: Path) -> None:
    file = tmp_path / "one.mcap"
    done = zarm("record", str(file), "--seconds", "0.5", ZARM_CONNECT=endpoint)
    assert done.returncode == 0, done.stderr
    assert list(read_record(file))


@pytest.mark.slow
def test_a_record_goes_on_when_the_router_is_back(tmp_path: Path) -> None:
    endpoint, file = free_endpoint(), tmp_path / "one.mcap"
    with ExitStack() as stack:
        first = stack.enter_context(ExitStack())
        first.enter_context(open_router(endpoint))
        bus = stack.enter_context(Bus(endpoint))
        stack.enter_context(ServiceProcess("executor", endpoint, tmp_path)).wait_ready(bus, KEYS)
        client = Client(bus)
        command = stack.enter_context(recording(endpoint, tmp_path, str(file)))
        begun(command)
        first.close()
        stack.enter_context(open_router(endpoint))
        seen = len(client.measured)
        eventually(lambda: len(client.measured) > seen, "the executor is heard again")
        draft = file.with_name("one.mcap.part")
        before = draft.stat().st_size
        eventually(lambda: draft.stat().st_size > before, "the record grows again")
        after = client.measured[-1]
        eventually(lambda: len(client.measured) > seen + 300, "time passes")
        command.interrupt()
        assert command.end() == 0
    assert encode(after) in {payload for _, key, payload in read_record(file) if key == KEYS.joint_states}


def test_a_file_that_is_there_is_not_overwritten(client: Client, endpoint: str, tmp_path: Path) -> None:
    file = tmp_path / "one.mcap"
    file.write_bytes(b"dear")
    done = zarm("record", str(file), ZARM_CONNECT=endpoint)
    assert done.returncode == 1
    assert str(file) in the_one_line(done.stderr)
    assert file.read_bytes() == b"dear"


def test_a_disk_that_is_full_ends_the_record_and_says_so(client: Client, endpoint: str, tmp_path: Path) -> None:
    nowhere = zarm("record", "/proc/one.mcap", ZARM_CONNECT=endpoint)
    assert nowhere.returncode == 3
    assert "/proc/one.mcap" in the_one_line(nowhere.stderr)

    file = tmp_path / "one.mcap"
    with recording(endpoint, tmp_path, str(file)) as command:
        begun(command)
        _, hard = resource.prlimit(command.process.pid, resource.RLIMIT_FSIZE)
        resource.prlimit(command.process.pid, resource.RLIMIT_FSIZE, (1000, hard))
        assert command.end() == 3
        assert f"{file}.part" in command.errors()
    assert not file.exists()


# -- replay --


@pytest.fixture
def file(tmp_path: Path) -> Path:
    """A record of what could move a robot, and of what could not."""
    path = tmp_path / "recorded.mcap"
    record = RecordFile(path, KEYS)
    for at in range(0, 4000, 10):
        record.write((at * 1_000_000, KEYS.speed, encode(Speed(speed_scale=0.5))))
        record.write((at * 1_000_000, KEYS.driver_command, b'{"sequence":1,"joint_names":["a"]}'))
    record.write((5_000_000_000, KEYS.joint_states, b"noise"))
    record.close()
    return path


def test_a_record_is_replayed_under_a_name_without_commands(bus: Bus, endpoint: str, file: Path) -> None:
    heard: list[tuple[str, bytes]] = []
    bus.listen("zarm/*/driver/command", lambda key, payload: heard.append((key, payload)))
    bus.listen("zarm/*/executor/stream", lambda key, payload: heard.append((key, payload)))
    speeds: list[tuple[str, bytes]] = []
    bus.listen("zarm/*/executor/speed", lambda key, payload: speeds.append((key, payload)))
    done = zarm("replay", str(file), "--publish", OTHER.robot, "--speed", "4", ZARM_CONNECT=endpoint)
    assert done.returncode == 0, done.stderr
    eventually(lambda: len(speeds) == 400, "all of it is heard")
    assert set(speeds) == {(OTHER.speed, encode(Speed(speed_scale=0.5)))}
    assert heard == []


def test_a_record_is_not_published_as_a_robot_that_is_there(client: Client, endpoint: str, file: Path) -> None:
    done = zarm("replay", str(file), "--publish", KEYS.robot, ZARM_CONNECT=endpoint)
    assert done.returncode == 3
    assert "give it another name" in the_one_line(done.stderr)
    assert client.state().mode == "idle"  # that executor has not given way


def test_no_executor_starts_under_a_replayed_name(bus: Bus, endpoint: str, file: Path, tmp_path: Path) -> None:
    with Command(
        "replay", str(file), "--publish", OTHER.robot, "--speed", "0.01", folder=tmp_path, ZARM_CONNECT=endpoint
    ) as command:
        eventually(lambda: bus.alive(OTHER.alive("executor", "*")), "the record is played")
        with ServiceProcess("executor", endpoint, tmp_path, name=OTHER.robot) as executor:
            assert executor.process.wait(60) == 1
            assert "is already on this bus" in executor.output()
        assert command.process.poll() is None
        command.interrupt()
        assert command.end() == 130


def test_what_is_no_record_is_refused_in_one_line(tmp_path: Path, file: Path) -> None:
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(file.read_bytes()[:-100])
    text = tmp_path / "text.mcap"
    text.write_text("no record")
    for path in (cut, text, tmp_path / "none.mcap", tmp_path):
        done = zarm("replay", str(path))
        assert done.returncode == 1, path
        assert os.fspath(path) in the_one_line(done.stderr)


def test_noise_on_record_is_counted(file: Path) -> None:
    done = zarm("replay", str(file))
    assert done.returncode == 0, done.stderr
    assert "1 message" in next(line for line in done.stdout.splitlines() if line.startswith("unreadable"))
