"""The robot follows a live target: planner, executor and servo in their own processes, led by Python clients and commands."""

from __future__ import annotations

import asyncio
import itertools
import os
import pty
import select
import signal
import subprocess
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import zarm
import zarm.aio
from support.command_line import ZARM, environment
from support.command_line import zarm as run_zarm
from support.executor.client import Client
from support.harness import PATIENCE, ServiceProcess, eventually, router
from support.planner.client import load
from support.tiers import sampled
from support.trajectories import HOME, KEYS, ROBOT
from zarm.servoing import PERIOD, Jogging
from zarm_contract.errors import Busy, DeadlineExceeded, Unavailable, from_problem
from zarm_contract.messages import (
    AddObjects,
    ChunkAccepted,
    Cuboid,
    EditBatch,
    JointPoints,
    SceneEdit,
    SceneObject,
    ServoChunk,
    ServoSession,
    ServoStart,
    SetPairCollision,
    Sphere,
    StreamChunk,
)
from zarm_geometry.exact import ExactScene
from zarm_geometry.robot_model import RobotModel
from zarm_geometry.world import World
from zarm_runtime.bus import Bus
from zarm_runtime.session import open_client
from zarm_servo.tracking.session import CHUNK

MODEL = RobotModel.of(ROBOT)
MARGIN = 0.01
PRECISION = 2e-3
"""What blending and the executor's ticks may add (m)."""
TIP = MODEL.fk_tip(HOME)[:3, 3]
WALL = Cuboid(kind="cuboid", name="wall", position=(float(TIP[0]) + 0.2, 0.0, 0.5), size=(0.1, 4.0, 3.0))


class Cell:
    """One robot with its processes, a client of Python and one that sees everything."""

    def __init__(self, stack: ExitStack, folder: Path) -> None:
        self.endpoint = stack.enter_context(router())
        self.bus = stack.enter_context(Bus(self.endpoint))
        self.services = {
            service: stack.enter_context(ServiceProcess(service, self.endpoint, folder))
            for service in ("planner", "leeloo_sim", "executor", "servo")
        }
        for process in self.services.values():
            process.wait_ready(self.bus, KEYS)
        self.client = Client(self.bus)
        self.robot = stack.enter_context(zarm.connect(self.endpoint))

    def home(self) -> None:
        """At rest where it began, in an empty scene."""
        self.client.cancel()
        self.client.mode("idle")
        load(self.bus)
        self.robot.execute(self.robot.plan(HOME))
        self.client.measured.clear()
        self.client.goals.clear()

    def assert_sound(self, *objects: SceneObject) -> None:
        """What was measured kept the limits of acceleration, and the margin to these objects."""
        assert self.client.greatest_acceleration() < 1.05
        positions = np.array([state.position for state in self.client.measured])
        nearest = ExactScene(MODEL, World(objects, 0.0)).nearest(positions).distance
        assert nearest >= MARGIN - PRECISION

    def repeat(
        self, jogging: Jogging, until: str, *, linear: tuple[float, float, float], within: float = np.inf
    ) -> ServoSession:
        """Jog, with a target every PERIOD, until this limits the robot, which has less clearance (m); what the servo tells then."""
        deadline = time.monotonic() + PATIENCE
        while time.monotonic() < deadline:
            jogging.twist(linear)
            state = jogging.state
            if (
                state is not None
                and state.limiting == until
                and (within == np.inf or (state.clearance or 0.0) < within)
            ):
                return state
            time.sleep(PERIOD)
        raise AssertionError(f"waited in vain until the robot is limited: {until}; last {jogging.state}")


@pytest.fixture(scope="module")
def shared(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cell]:
    with ExitStack() as stack:
        yield Cell(stack, tmp_path_factory.mktemp("cell"))


@pytest.fixture
def cell(shared: Cell) -> Cell:
    shared.home()
    return shared


def test_a_pose_beside_a_wall_is_reached_and_one_behind_is_named(cell: Cell) -> None:
    load(cell.bus, WALL)
    here = cell.robot.tip()
    with cell.robot.track() as tracking:
        there = zarm.Pose(np.add(here.position, (0.03, 0.1, -0.05)), here.orientation)
        tracking.reach(there, timeout=PATIENCE)
        assert np.linalg.norm(np.subtract(cell.robot.tip().position, there.position)) < 0.0015
        behind = zarm.Pose(np.add(here.position, (0.5, 0.1, 0.0)), here.orientation)

        def says_the_wall() -> bool:
            with pytest.raises(DeadlineExceeded) as reported:
                tracking.reach(behind, timeout=1.0)
            return "wall" in str(reported.value)

        eventually(says_the_wall, "it says what is in the way")
        tracking.reach(HOME, timeout=PATIENCE)
    assert cell.client.ended(tracking.goal_id).status == "succeeded"
    cell.assert_sound(WALL)


def test_jogging_slows_before_a_wall_slides_and_times_out(cell: Cell) -> None:
    load(cell.bus, WALL)
    with cell.robot.jog() as jogging:
        slowed = cell.repeat(jogging, "slowing", linear=(0.2, 0.1, 0.0))
        assert slowed.object == "wall"
        assert slowed.clearance is not None
        eventually(lambda: jogging.state is not None and jogging.state.limiting == "target_stale", "it is stale")
        eventually(lambda: not any(cell.client.measured[-1].velocity), "the robot rests")
        assert cell.client.stands()
    cell.assert_sound(WALL)


def test_a_new_obstacle_is_avoided_in_a_session(cell: Cell) -> None:
    x, y, z = (TIP + (0.0, 0.35, 0.0)).tolist()
    ball = Sphere(kind="sphere", name="ball", position=(x, y, z), radius=0.08)
    with cell.robot.jog() as jogging:
        cell.repeat(jogging, "free", linear=(0.0, 0.1, 0.0))
        load(cell.bus, ball)
        slowed = cell.repeat(jogging, "slowing", linear=(0.0, 0.2, 0.0))
        assert slowed.object == "ball"
    cell.assert_sound(ball)


def test_a_link_allowed_to_touch_is_held_by_no_servo(cell: Cell) -> None:
    x, y, z = (TIP + 0.03 * MODEL.fk_tip(HOME)[:3, 2]).tolist()
    ball = Sphere(kind="sphere", name="ball", position=(x, y, z), radius=0.03)
    pair = SetPairCollision(op="pairs", names=(("link_6", "ball"),), enabled=False)
    load(cell.bus, ball)
    with cell.robot.jog() as jogging:
        assert cell.repeat(jogging, "blocked", linear=(0.0, 0.0, -0.1)).object == "ball"
        cell.robot.scene.apply(SceneEdit(edit=pair))
        cell.repeat(jogging, "free", linear=(0.05, 0.0, 0.0))
    load(cell.bus)
    goal_id = cell.robot.start(cell.robot.plan(HOME + (0.0, 0.0, 0.0, 0.0, 0.0, 1.0), velocity_scale=0.2))
    cell.robot.scene.apply(SceneEdit(edit=EditBatch(op="batch", edits=(AddObjects(op="add", objects=(ball,)), pair))))
    states = list(cell.robot.executor.goal_states(goal_id))
    assert states[-1].status == "succeeded"
    assert not any(state.hold for state in states)


@pytest.mark.slow  # as in unit/servo/test_controller.py
def test_a_robot_in_collision_moves_only_outwards(cell: Cell) -> None:
    x, y, z = (TIP + (0.085, 0.0, 0.0)).tolist()
    ball = Sphere(kind="sphere", name="ball", position=(x, y, z), radius=0.08)
    scene = ExactScene(MODEL, World([ball], 0.0))
    load(cell.bus, ball)
    chunks: list[StreamChunk] = []
    unsubscribe = cell.bus.subscribe(KEYS.stream, lambda _, chunk: chunks.append(chunk))
    with cell.robot.jog() as jogging:
        assert cell.repeat(jogging, "blocked", linear=(0.1, 0.0, 0.0)).object == "ball"
        cell.repeat(jogging, "free", linear=(-0.1, 0.0, 0.0))
    unsubscribe()

    def distances(positions: Iterable[tuple[float, ...]]) -> np.ndarray:
        return np.array([scene.nearest(np.array(position), itself=False).distance for position in positions])

    assert chunks
    for chunk in chunks:  # its steps, and the braking after them
        commanded = distances(chunk.trajectory.position[::CHUNK])
        assert np.diff(np.minimum(commanded, MARGIN)).min(initial=0.0) > -1e-5
    measured = distances(state.position for state in cell.client.measured[::5])
    assert measured[0] < 0.0
    assert measured[-1] > MARGIN - PRECISION
    assert np.diff(np.minimum(measured, MARGIN)).min() > -5e-4  # blends of the executor included


@pytest.mark.slow  # as in unit/servo/test_check.py
def test_what_is_attached_is_kept_away_too(cell: Cell) -> None:
    x, y, z = TIP.tolist()
    table = Cuboid(kind="cuboid", name="table", position=(x, y, z - 0.3), size=(0.4, 0.4, 0.1))
    load(cell.bus, table)
    cell.robot.scene.add(zarm.Cuboid("tool", size=(0.04, 0.04, 0.1), position=(x, y, z - 0.06)))
    cell.robot.scene.attach("tool")
    with cell.robot.jog() as jogging:
        slowed = cell.repeat(jogging, "slowing", linear=(0.0, 0.0, -0.1))
        assert slowed.object == "table"
        cell.repeat(jogging, "slowing", linear=(0.0, 0.0, -0.1), within=2 * MARGIN)
    holding = MODEL.with_attached(tuple(cell.robot.scene.attached().values()), ())
    positions = np.array([state.position for state in cell.client.measured])
    assert ExactScene(holding, World([table], 0.0)).nearest(positions).distance >= MARGIN - PRECISION


def test_a_second_client_must_take_over_the_session(cell: Cell) -> None:
    with cell.robot.jog() as first:
        with pytest.raises(Busy, match=first.goal_id), cell.robot.jog():
            pass
        with cell.robot.jog(take_over=True) as second:
            eventually(lambda: not first.running, "the first session has ended")
            cell.repeat(second, "free", linear=(0.0, 0.05, 0.0))
    cell.client.mode("idle")


def test_a_session_beside_a_goal_is_refused_and_stop_ends_it(cell: Cell) -> None:
    goal = cell.robot.start(cell.robot.plan((1.0, *HOME[1:])))
    eventually(lambda: cell.client.state().goal_id == goal, "the goal runs")
    with pytest.raises(Busy, match=goal), cell.robot.jog():
        pass
    cell.robot.cancel(goal)
    cell.client.mode("idle")

    def led_until_stopped() -> None:
        with cell.robot.jog() as jogging:
            cell.repeat(jogging, "free", linear=(0.0, 0.05, 0.0))
            cell.robot.stop()
            eventually(lambda: not jogging.running, "the session has ended")

    with pytest.raises(zarm.Cancelled):
        led_until_stopped()
    assert cell.client.mode("idle").problem is None


@pytest.mark.parametrize(
    ("target", "problem"),
    sampled(
        ('{"kind": "twist", "linear": [0.1, 0, 0]}', 'write "base" or "tool" (target.frame)'),
        (
            '{"kind": "twist", "frame": "base", "linear": [NaN, 0, 0]}',
            "Input should be a finite number (target.linear.0)",
        ),
        ('{"kind": "joint_speed", "velocity": [0.1]}', "1 values, and this robot has 6 joints (target.velocity)"),
    ),
)
def test_an_invalid_target_is_refused_by_field(cell: Cell, target: str, problem: str) -> None:
    with cell.robot.jog() as jogging, open_client(cell.endpoint) as session:
        text = f'{{"goal_id": "{jogging.goal_id}", "sequence": 1, "stamp": 1.0, "target": {target}}}'

        def refused() -> str | None:
            session.put(KEYS.servo_target, text)
            state = jogging.state
            return None if state is None or state.refused is None else str(from_problem(state.refused))

        assert eventually(refused, "the target is refused").endswith(problem)
    assert cell.client.stands()


def swing(times: np.ndarray) -> np.ndarray:
    """The first joint swings by 0.2 rad about HOME, from rest at 0 s."""
    return HOME + 0.2 * (1.0 - np.cos(times))[:, None] * np.eye(6)[0]


def follow_swing(cell: Cell, seconds: float, tracking: zarm.ChunkTracking) -> list[ChunkAccepted]:
    """Send a chunk of the swing 20 times a second; the answers."""
    answers, begun = [], time.time()
    while time.time() < begun + seconds:
        now = time.time()
        answers.append(tracking.follow(swing(now - begun + np.arange(20) / 20), dt=1 / 20, start=now))
        time.sleep(1 / 20)
    return answers


def test_chunks_lead_the_robot_and_when_they_end_it_rests(cell: Cell) -> None:
    with cell.robot.track(chunks=True) as tracking:
        answers = follow_swing(cell, 3.0, tracking)
        assert {answer.limiting for answer in answers} <= {"free", "target_stale"}
        assert answers[-1].clipped == ()
        eventually(lambda: cell.client.stands(), "the robot rests when no more come")
    positions = np.array([state.position for state in cell.client.measured])
    assert np.ptp(positions[:, 0]) > 0.3
    assert np.ptp(positions[:, 1:], axis=0).max() < 2e-3
    cell.assert_sound()


def test_asynchronous_chunks_leave_the_loop_to_others(cell: Cell) -> None:
    async def main() -> list[ChunkAccepted]:
        answers = []
        async with zarm.aio.connect(cell.endpoint) as arm, arm.track(chunks=True) as tracking:
            for _ in range(3):
                sent = asyncio.create_task(tracking.follow(np.tile(HOME, (5, 1)), dt=0.1))
                await asyncio.sleep(0)
                assert not sent.done()
                answers.append(await sent)
            assert tracking.running
            with pytest.raises(zarm.InvalidRequest):
                await tracking.follow(np.zeros((5, 5)), dt=0.1)
        return answers

    assert [answer.lost for answer in asyncio.run(main())] == [0, 0, 0]
    assert cell.client.stands()


def test_what_blocks_a_chunk_is_named_and_avoided(cell: Cell) -> None:
    x, y, z = MODEL.fk_tip(swing(np.array([1.8]))[0])[:3, 3].tolist()
    ball = Sphere(kind="sphere", name="ball", position=(x, y, z), radius=0.05)
    load(cell.bus, ball)
    with cell.robot.track(chunks=True) as tracking:
        answers = follow_swing(cell, 2.5, tracking)
    assert "ball" in {answer.object for answer in answers}
    cell.assert_sound(ball)


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"start": 1e12}, "start"),
        ({"dt": float("nan")}, "dt"),
        ({"points": np.full((5, 6), 3.0)}, "points"),
        ({"points": np.zeros((5, 5))}, "points.position[0]"),
        ({"times": (0.0, 0.1)}, "dt"),
        ({"gripper": "hand", "opening": (0.0,) * 5}, "gripper"),
    ],
)
def test_a_chunk_that_cannot_be_followed_is_refused_by_field(cell: Cell, change: dict[str, Any], field: str) -> None:
    with cell.robot.track(chunks=True) as tracking:
        with pytest.raises(zarm.InvalidRequest) as refused:
            tracking.follow(**({"points": np.tile(HOME, (5, 1)), "dt": 0.1} | change))
        assert refused.value.problem.field == field
        tracking.follow(np.tile(HOME, (5, 1)), dt=0.1)
    assert cell.client.stands()


def test_chunks_of_a_session_that_is_not_open_are_refused(cell: Cell) -> None:
    with cell.robot.track(chunks=True) as tracking:
        pass
    with pytest.raises(Unavailable, match=r"has ended|is not open"):
        tracking.follow(np.tile(HOME, (5, 1)), dt=0.1)
    points = JointPoints(kind="joints", position=(tuple(HOME),) * 2)
    chunk = ServoChunk(goal_id=tracking.goal_id, sequence=1, stamp=time.time(), dt=0.1, points=points)
    with pytest.raises(Unavailable, match=tracking.goal_id):
        cell.bus.call(KEYS.servo_chunk, chunk, timeout=PATIENCE)


def test_out_of_order_targets_and_set_back_clocks_are_refused(cell: Cell) -> None:
    with cell.robot.jog() as jogging, open_client(cell.endpoint) as session:

        def refused(sequence: int, stamp: float) -> str | None:
            target = '{"kind": "twist", "frame": "base", "linear": [0, 0, 0]}'
            session.put(
                KEYS.servo_target,
                f'{{"goal_id": "{jogging.goal_id}", "sequence": {sequence}, "stamp": {stamp}, "target": {target}}}',
            )
            state = jogging.state
            return None if state is None or state.refused is None else state.refused.field

        eventually(lambda: refused(7, 50.0) == "sequence", "the same number again is refused")
        eventually(lambda: refused(8, 40.0) == "stamp", "what was made before is refused")
    assert cell.client.stands()


def test_a_number_far_ahead_is_refused_and_later_targets_count(cell: Cell) -> None:
    with cell.robot.jog() as jogging, open_client(cell.endpoint) as session:

        def say(sequence: int, stamp: float) -> None:
            target = '{"kind": "twist", "frame": "base", "linear": [0, 0.05, 0]}'
            session.put(
                KEYS.servo_target,
                f'{{"goal_id": "{jogging.goal_id}", "sequence": {sequence}, "stamp": {stamp}, "target": {target}}}',
            )

        numbers = itertools.count(1)

        def follows(refused: str | None) -> bool:
            """Send one more target; whether the robot moves after one of the last, and this field of another was refused."""
            number = next(numbers)
            say(number, time.monotonic())
            state = jogging.state
            follows = state is not None and state.moving and state.sequence >= number - 10
            return follows and refused == (state.refused and state.refused.field)

        eventually(lambda: follows(None), "the robot follows")
        say(10**9, time.monotonic())
        eventually(lambda: follows("sequence"), "the number is refused")
        say(next(numbers), 1e12)
        eventually(lambda: follows("stamp"), "the stamp is refused")


@pytest.mark.slow  # as in unit/servo/test_controller.py and test_inbox.py
def test_of_a_thousand_targets_a_second_the_newest_counts(cell: Cell) -> None:
    with cell.robot.jog() as jogging:
        for sent in range(1000):
            jogging.joint_speed((0.2 if sent % 2 else -0.2, 0.0, 0.0, 0.0, 0.0, 0.1))
            time.sleep(0.001)
        eventually(lambda: jogging.state is not None and jogging.state.sequence == 1000, "the newest has come")
    cell.assert_sound()


def test_a_pause_ends_a_session_and_leaves_its_goal_paused(cell: Cell) -> None:
    session = cell.bus.call(KEYS.servo_start, ServoStart(), timeout=PATIENCE)
    cell.client.mode("running")
    cell.robot.pause()
    cell.client.mode("paused")
    with pytest.raises(Busy, match=session.goal_id), cell.robot.jog(take_over=True):
        pass
    cell.robot.cancel(session.goal_id)
    assert cell.client.ended(session.goal_id).status == "cancelled"


def test_after_a_delay_the_session_resumes_from_the_robot(cell: Cell) -> None:
    chunks: list[bytes] = []
    cell.bus.listen(KEYS.stream, lambda _, payload: chunks.append(payload))
    here, executor = cell.robot.tip(), cell.services["executor"].process
    with cell.robot.jog() as jogging:
        cell.repeat(jogging, "free", linear=(0.0, 0.1, 0.0))
        executor.send_signal(signal.SIGSTOP)
        try:
            seen = len(chunks)
            eventually(lambda: len(chunks) >= seen + 5, "chunks wait for the executor")
        finally:
            executor.send_signal(signal.SIGCONT)
        cell.repeat(jogging, "free", linear=(0.0, 0.1, 0.0))
    with cell.robot.track() as tracking:
        tracking.reach(here, timeout=PATIENCE)
    assert cell.client.ended(tracking.goal_id).status == "succeeded"
    cell.assert_sound()


@pytest.fixture
def driven(cell: Cell) -> Iterator[Callable[[str], None]]:
    """Have a driver move the robot, by another strategy, and then the emulator again."""

    def switch(strategy: str) -> None:
        cell.client.strategy(strategy)
        eventually(cell.client.stands, "the arm of the driver is told, which is elsewhere than the emulated one was")

    yield switch
    cell.client.strategy("emulator")


@pytest.mark.slow
@pytest.mark.parametrize("strategy", ["joint_speed", "joint_pose"])
def test_a_driver_is_led_as_well(cell: Cell, driven: Callable[[str], None], strategy: str) -> None:
    driven(strategy)
    at = cell.client.position()
    there = at + (0.1, 0.05, -0.05, 0.0, 0.0, 0.1)
    with cell.robot.track() as tracking:
        tracking.reach(there, timeout=PATIENCE)
    assert cell.client.ended(tracking.goal_id).status == "succeeded"
    np.testing.assert_allclose(cell.client.position(), there, atol=0.005)


def test_joint_trajectory_refuses_sessions(cell: Cell, driven: Callable[[str], None]) -> None:
    driven("joint_trajectory")
    with pytest.raises(zarm.Unavailable, match="switch to another strategy"), cell.robot.jog():
        pass
    assert cell.client.stands()


def test_keys_in_a_terminal_move_the_robot(cell: Cell) -> None:
    above, below = pty.openpty()
    command = [ZARM, "jog", "--connect", cell.endpoint]
    with subprocess.Popen(command, stdin=below, stdout=below, stderr=below, env=environment()) as jog:
        os.close(below)

        def moves() -> bool:
            os.write(above, b"f")
            return bool(cell.client.measured) and any(cell.client.measured[-1].velocity)

        eventually(moves, "the robot moves")
        os.write(above, b"q")
        assert drained(above, jog) == 0
    os.close(above)
    cell.client.mode("idle")
    cell.assert_sound()


def drained(terminal: int, process: subprocess.Popen[bytes]) -> int:
    """What the process ends with; what it shows on its terminal is read, so that it never waits for that."""

    def ended() -> bool:
        while select.select([terminal], [], [], 0.05)[0]:
            try:
                if not os.read(terminal, 65536):
                    break
            except OSError:  # nobody is at the other end any more
                break
        return process.poll() is not None

    eventually(ended, "the command has ended")
    return process.returncode


def test_a_command_moves_to_joint_positions_without_a_plan(cell: Cell) -> None:
    goal = (0.1, 0.05, *HOME[2:])
    led = run_zarm("track", "--joints", ",".join(map(str, goal)), "--connect", cell.endpoint)
    assert led.returncode == 0, led.stderr
    assert led.stdout.startswith("reached to")
    np.testing.assert_allclose(cell.client.position(), goal, atol=0.003)
    cell.assert_sound()


def test_the_refusal_names_the_command_that_leaves_collision(cell: Cell) -> None:
    x, y, z = (TIP + (0.085, 0.0, 0.0)).tolist()
    load(cell.bus, Sphere(kind="sphere", name="ball", position=(x, y, z), radius=0.08))
    goal = ",".join(map(str, (1.0, *HOME[1:])))
    refused = run_zarm("plan", "--joints", goal, "--connect", cell.endpoint)
    assert "start_in_collision" in refused.stderr
    assert "`zarm track`" in refused.stderr
    led = run_zarm("track", "--joints", goal, "--connect", cell.endpoint)
    assert led.returncode == 0, led.stderr
    np.testing.assert_allclose(cell.client.position()[0], 1.0, atol=0.003)
