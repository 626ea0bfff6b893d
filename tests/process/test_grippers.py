"""Grippers, with planner, executor and servo in their own processes: what they hold, refuse, and what plans know of them."""

from __future__ import annotations

import json
import shutil
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import numpy as np
import pytest

import zarm
from support.command_line import zarm as run_zarm
from support.harness import PATIENCE, ServiceProcess, eventually, router
from support.planner.second_opinion import Collisions, link_pose
from zarm_contract.codec import encode
from zarm_contract.keys import Keys
from zarm_contract.messages import (
    DriverFault,
    DriverGripperCommand,
    DriverGripperState,
    GripperRequest,
    JointState,
)
from zarm_contract.robot import ROBOTS, load_robot
from zarm_runtime.bus import Bus

PANDA = load_robot("panda")
HOME = PANDA.descriptor.home
KEYS = Keys("panda")
BEHIND = (0.9, *HOME[1:])
OPEN_FINGER = link_pose(PANDA, "panda_leftfinger", HOME) @ [0.0, 0.012, 0.044, 1.0]
"""Where the tip of the left finger is with the open gripper at home, m."""


class Cell:
    """A Panda with its planner, executor and servo, and a client."""

    def __init__(self, stack: ExitStack, folder: Path) -> None:
        self.endpoint = stack.enter_context(router())
        self.bus = stack.enter_context(Bus(self.endpoint))
        for service in ("planner", "executor", "servo"):
            process = ServiceProcess(service, self.endpoint, folder, "panda")
            stack.enter_context(process).wait_ready(self.bus, KEYS)
        self.robot = stack.enter_context(zarm.connect(self.endpoint))

    def home(self) -> None:
        """At rest at home with an open gripper, in an empty scene."""
        self.robot.stop()
        self.robot.scene.clear()
        self.robot.gripper.open(preempt=True)
        self.robot.execute(self.robot.plan(HOME))


@pytest.fixture(scope="module")
def module_cell(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cell]:
    with ExitStack() as stack:
        yield Cell(stack, tmp_path_factory.mktemp("cell"))


@pytest.fixture
def cell(module_cell: Cell) -> Cell:
    module_cell.home()
    return module_cell


def test_a_gripper_closes_moves_to_a_width_and_opens(cell: Cell) -> None:
    widths: list[float | None] = []
    closed = cell.robot.gripper.close(on_progress=lambda state: widths.append(state.width))
    assert (closed.status, closed.width) == ("reached", pytest.approx(0.0, abs=1e-3))
    assert len(set(widths)) > 3, "it reports its way"
    assert cell.robot.gripper.move(0.03).width == pytest.approx(0.03, abs=1e-3)
    assert cell.robot.gripper.state().position == pytest.approx(0.015, abs=5e-4)
    assert cell.robot.gripper.open("hand").width == pytest.approx(0.08, abs=1e-3)


def test_the_command_line_opens_and_closes(cell: Cell) -> None:
    def told(*arguments: str) -> dict[str, object]:
        done = run_zarm("gripper", *arguments, "--json", ZARM_CONNECT=cell.endpoint)
        return dict(json.loads(done.stdout))

    assert told("close")["status"] == "reached"
    assert told("move", "0.04", "--force", "20", "--speed", "0.05")["width"] == pytest.approx(0.04, abs=1e-3)
    assert told("state")["target"] == 0.04
    assert told("open")["status"] == "reached"


def test_a_plan_holds_for_the_opening_it_was_made_with(cell: Cell) -> None:
    plan = cell.robot.plan(BEHIND)
    assert [(one.gripper, one.width) for one in plan.openings] == [("hand", 0.08)]
    cell.robot.gripper.close()
    with pytest.raises(
        zarm.ExecutionRefused, match=r"was verified with hand at 0\.08 m, which is at 0\.000 m now"
    ) as refused:
        cell.robot.execute(plan)
    assert refused.value.code == "stale_plan"
    assert cell.robot.execute(cell.robot.plan(BEHIND)).status == "succeeded"


def test_a_saved_plan_keeps_the_opening_that_it_holds_for(cell: Cell, tmp_path: Path) -> None:
    file, to = tmp_path / "plan.json", ",".join(map(str, BEHIND))
    saved = run_zarm("plan", "--joints", to, "--save", str(file), ZARM_CONNECT=cell.endpoint)
    assert saved.returncode == 0, saved.stderr
    cell.robot.gripper.close()
    refused = run_zarm("execute", "--plan", str(file), ZARM_CONNECT=cell.endpoint)
    assert "stale_plan: the trajectory was verified with hand at 0.08 m" in refused.stderr
    cell.robot.gripper.open()
    assert run_zarm("execute", "--plan", str(file), ZARM_CONNECT=cell.endpoint).returncode == 0


def test_a_saved_plan_that_would_leave_its_grips_out_is_refused(cell: Cell, tmp_path: Path) -> None:
    file = tmp_path / "plan.json"
    file.write_bytes(encode(cell.robot.plan_program(picking(0.03))))
    refused = run_zarm("execute", "--plan", str(file), ZARM_CONNECT=cell.endpoint)
    assert "a segment that would be left out, grip; run the program" in refused.stderr
    assert refused.returncode == 1
    assert cell.robot.joint_state().position == pytest.approx(HOME)


def test_collision_geometry_follows_the_measured_opening(cell: Cell) -> None:
    cell.robot.scene.add(zarm.Sphere("pin", radius=0.004, position=OPEN_FINGER[:3]))
    (touching,) = cell.robot.check([HOME])
    assert touching.in_collision
    assert touching.pair is not None
    assert set(touching.pair) == {"panda_leftfinger", "pin"}
    cell.robot.gripper.close()
    (free,) = cell.robot.check([HOME])
    assert free.clearance > 0.01


def test_a_plan_for_another_opening_names_it(cell: Cell) -> None:
    cell.robot.scene.add(zarm.Sphere("pin", radius=0.004, position=OPEN_FINGER[:3]))
    with pytest.raises(zarm.PlanningFailed):
        cell.robot.plan(BEHIND)
    closed = cell.robot.plan(BEHIND, openings={"hand": 0.0})
    assert closed.openings[0].width == 0.0
    with pytest.raises(zarm.InvalidRequest, match=r"hand cannot open 0\.2 m"):
        cell.robot.plan(BEHIND, openings={"hand": 0.2})


def test_a_stop_holds_the_fingers_where_they_are(cell: Cell) -> None:
    goal = cell.bus.call(KEYS.gripper, GripperRequest(width=0.0, speed=0.01), timeout=PATIENCE).goal_id
    eventually(lambda: (cell.robot.gripper.state().width or 0.0) < 0.078, "the fingers move")
    cell.robot.stop()
    stopped = cell.robot.gripper.state()
    assert (stopped.status, stopped.goal_id) == ("cancelled", goal)
    assert stopped.width is not None
    assert 0.05 < stopped.width < 0.079
    assert cell.robot.gripper.state().width == pytest.approx(stopped.width, abs=1e-6)


def test_a_second_client_waits_cancels_or_preempts(cell: Cell) -> None:
    cell.bus.call(KEYS.gripper, GripperRequest(width=0.0, speed=0.01), timeout=PATIENCE)
    with pytest.raises(zarm.Busy, match="hand moves for"):
        cell.robot.gripper.open()
    assert cell.robot.gripper.cancel().status == "cancelled"
    cell.bus.call(KEYS.gripper, GripperRequest(width=0.0, speed=0.01), timeout=PATIENCE)
    with pytest.raises(zarm.Busy, match="plan and execute when that has ended"):
        cell.robot.execute(cell.robot.plan(HOME))
    assert cell.robot.gripper.open(preempt=True).status == "reached"


@pytest.mark.parametrize(
    ("request_", "field"),
    [
        ({"gripper": "claw", "width": 0.0}, "gripper"),
        ({"width": 0.1}, "width"),
        ({"position": 0.05}, "position"),
        ({}, "width"),
        ({"width": 0.0, "force": 100.0}, "force"),
    ],
)
def test_what_a_gripper_cannot_do_is_refused(cell: Cell, request_: dict[str, object], field: str) -> None:
    with pytest.raises(zarm.InvalidRequest) as refused:
        cell.bus.call(KEYS.gripper, GripperRequest.model_validate(request_), timeout=PATIENCE)
    assert refused.value.problem.field == field
    assert cell.robot.gripper.state().width == pytest.approx(0.08, abs=1e-3)


def test_fingers_that_open_beside_something_hold_the_guarded_arm(cell: Cell) -> None:
    """The plan is for a closed gripper past a pin; while it opens in motion, the servo stops the arm before the pin."""
    robot = cell.robot
    robot.gripper.close()
    at = (0.5, *HOME[1:])
    pin = link_pose(PANDA, "panda_leftfinger", at) @ [0.0, 0.012, 0.044, 1.0]
    robot.scene.add(zarm.Sphere("pin", radius=0.004, position=pin[:3]))
    goal = robot.start(robot.plan(BEHIND, velocity_scale=0.1))
    eventually(lambda: robot.state().guarded, "a servo guards the motion")
    robot.gripper.open()
    held = next(state for state in robot.goal_states(goal) if state.hold is not None or state.done)
    assert held.hold is not None
    assert held.hold.obstruction is not None
    assert held.hold.obstruction.object == "pin"
    robot.gripper.close()
    assert robot.follow(goal).status == "succeeded"


def test_fingers_that_open_beside_nothing_hold_no_guarded_arm(cell: Cell) -> None:
    """The open fingers would touch the pin; these are checked where they are."""
    robot = cell.robot
    robot.gripper.close()
    pin = link_pose(PANDA, "panda_leftfinger", (0.5, *HOME[1:])) @ [0.0, 0.012, 0.044, 1.0]
    robot.scene.add(zarm.Sphere("pin", radius=0.004, position=pin[:3]))
    goal = robot.start(robot.plan(BEHIND, velocity_scale=0.1))
    eventually(lambda: robot.state().guarded, "a servo guards the motion")
    robot.gripper.move(0.02)
    states = list(robot.goal_states(goal))
    assert states[-1].status == "succeeded"
    assert [state.hold for state in states if state.hold is not None] == []


def test_a_target_beside_a_pin_is_tracked_with_closed_fingers(cell: Cell) -> None:
    start, to = (0.6, *HOME[1:]), (0.2, *HOME[1:])
    pin = link_pose(PANDA, "panda_leftfinger", to) @ [0.0, 0.012, 0.044, 1.0]
    ball = zarm.Sphere("pin", radius=0.004, position=pin[:3])
    for width in (0.0, 0.08):
        cell.home()
        cell.robot.execute(cell.robot.plan(start))
        cell.robot.gripper.move(width)
        cell.robot.scene.add(ball)
        passed: list[tuple[float, ...]] = []
        with cell.robot.track() as tracking:

            def ends(
                width: float = width, tracking: zarm.Tracking = tracking, passed: list[tuple[float, ...]] = passed
            ) -> bool:
                tracking.to(to)
                passed.append(cell.robot.joint_state().position)
                if width == 0.0:
                    return bool(np.allclose(passed[-1], to, atol=0.01))
                return passed[-1][0] < 0.55 and passed[-1] == passed[-2]

            eventually(ends, "it is there, or stands before the pin")
        collisions = Collisions(PANDA, [ball], widths={"hand": width})
        assert not any(collisions.at(q) for q in passed)


def test_a_chunk_moves_the_gripper_too(cell: Cell) -> None:
    cell.home()
    cell.robot.gripper.open()
    opening = np.linspace(0.08, 0.02, 20)
    with cell.robot.track(chunks=True) as tracking:
        tracking.follow(np.tile(HOME, (20, 1)), dt=0.05, gripper="hand", opening=opening)
        eventually(lambda: abs(cell.robot.gripper.state().width - 0.02) < 0.003, "it closes to where the chunk ends")
        with pytest.raises(zarm.InvalidRequest, match=r"opening\[1\]"):
            tracking.follow(np.tile(HOME, (2, 1)), dt=2.0, gripper="hand", opening=(0.02, 0.5))


def picking(width: float, **grip: float) -> list[object]:
    """A program: over there with an open gripper, close it to a width, back, and open it."""
    return [
        zarm.Move(BEHIND),
        zarm.Grip(width, **grip),
        zarm.Move(HOME),
        zarm.Grip(0.08),
    ]


def test_a_program_waits_for_its_grippers_and_goes_on(cell: Cell) -> None:
    plan = cell.robot.plan_program(picking(0.03))
    assert [segment.action for segment in plan.segments] == ["move", "grip", "move", "grip"]
    assert [(one.gripper, one.width) for one in plan.openings] == [("hand", 0.08)]
    waited: list[tuple[float, float | None]] = []

    def note(state: zarm.GoalState) -> None:
        if state.hold is not None:
            assert state.hold.reason == "gripper"
            waited.append((state.progress * state.duration, cell.robot.gripper.state().width))

    last = cell.robot.execute(plan, on_progress=note)
    assert last.status == "succeeded"
    (first, second) = (segment for segment in plan.segments if segment.grip is not None)
    assert {first.begin <= at <= first.end or second.begin <= at <= second.end for at, _ in waited} == {True}
    assert cell.robot.gripper.state().width == pytest.approx(0.08, abs=1e-3)


def test_a_program_may_begin_with_a_grip_and_be_paused_at_it(cell: Cell) -> None:
    plan = cell.robot.plan_program([zarm.Grip(0.0, speed=0.02), zarm.Grip(0.04), zarm.Move(BEHIND)])
    goal = cell.robot.start(plan)
    eventually(lambda: cell.robot.gripper.state().status == "moving", "the gripper moves")
    cell.robot.pause()
    eventually(lambda: cell.robot.gripper.state().status == "reached", "the fingers are closed")
    eventually(lambda: cell.robot.state().mode == "paused", "the robot is paused")
    assert cell.robot.joint_state().position == pytest.approx(HOME)
    cell.robot.resume()
    assert cell.robot.follow(goal).status == "succeeded"
    assert cell.robot.gripper.state().width == pytest.approx(0.04, abs=1e-3)
    assert cell.robot.joint_state().position == pytest.approx(BEHIND, abs=1e-3)


def test_what_follows_a_grip_is_verified_with_its_opening(cell: Cell) -> None:
    """At the end the open finger touches a pin: it may be closed there, and not be opened."""
    cell.robot.plan_program([zarm.Move(BEHIND), zarm.Grip(0.0), zarm.Move(HOME)])
    cell.robot.execute(cell.robot.plan(BEHIND))
    cell.robot.gripper.close()
    cell.robot.scene.add(zarm.Sphere("pin", radius=0.004, position=OPEN_FINGER[:3]))
    closed = cell.robot.plan_program([zarm.Move(HOME), zarm.Move(BEHIND), zarm.Grip(0.08)])
    assert cell.robot.execute(closed).status == "succeeded"
    cell.robot.gripper.close()
    with pytest.raises(zarm.PlanningFailed, match=r"segment 1: with hand at 0\.08 m .* would touch") as refused:
        cell.robot.plan_program([zarm.Move(HOME), zarm.Grip(0.08)])
    assert refused.value.problem.field == "segments.1"


@pytest.mark.parametrize(
    ("grip", "field"),
    [(zarm.Grip(0.2), "segments.1.width"), (zarm.Grip(0.02, gripper="claw"), "segments.1.gripper")],
)
def test_a_grip_that_no_gripper_can_do_is_refused_in_planning(cell: Cell, grip: zarm.Grip, field: str) -> None:
    with pytest.raises(zarm.InvalidRequest) as refused:
        cell.robot.plan_program([zarm.Move(BEHIND), grip])
    assert refused.value.problem.field == field


def test_a_cancel_while_a_gripper_moves_stops_both(cell: Cell) -> None:
    goal = cell.robot.start(cell.robot.plan_program(picking(0.0, speed=0.01)))
    eventually(lambda: cell.robot.gripper.state().status == "moving", "the gripper moves")
    cell.robot.cancel(goal)
    assert cell.robot.follow(goal).status == "cancelled"
    eventually(lambda: cell.robot.gripper.state().status == "cancelled", "the fingers stand")


@pytest.mark.parametrize("strategy", ["joint_trajectory", "joint_speed", "joint_pose"])
def test_a_driven_robot_waits_at_rest_for_a_real_gripper(driven: Path, tmp_path: Path, strategy: str) -> None:
    with ExitStack() as stack:
        endpoint = stack.enter_context(router())
        bus = stack.enter_context(Bus(endpoint))
        for service, arguments in (("planner", ()), ("leeloo_sim", ()), ("executor", ("--strategy", strategy))):
            process = ServiceProcess(service, endpoint, tmp_path, str(driven), arguments=arguments)
            stack.enter_context(process).wait_ready(bus, KEYS)
        robot = stack.enter_context(zarm.connect(endpoint))
        bus.call(KEYS.simulated_fault, DriverFault(obstacle=0.031), timeout=PATIENCE)
        plan = robot.plan_program(picking(0.03), velocity_scale=0.3, acceleration_scale=0.1)
        assert robot.execute(plan).status == "succeeded"
        assert robot.gripper.state().status == "reached"
        bus.call(KEYS.simulated_fault, DriverFault(obstacle=0.05), timeout=PATIENCE)
        plan = robot.plan_program(picking(0.03), velocity_scale=0.3, acceleration_scale=0.1)
        with pytest.raises(zarm.ExecutionFailed, match=r"stand at 0\.0500 m, not at 0\.03 m"):
            robot.execute(plan)
        assert robot.joint_state().position == pytest.approx(BEHIND, abs=0.02)


def test_a_robot_without_grippers_says_so(tmp_path: Path) -> None:
    with router() as endpoint, Bus(endpoint) as bus, ServiceProcess("executor", endpoint, tmp_path) as process:
        process.wait_ready(bus, Keys("doosan_m1013"))
        with zarm.connect(endpoint) as robot, pytest.raises(zarm.InvalidRequest, match="has no gripper; describe it"):
            robot.gripper.open()


def test_an_unknown_gripper_is_refused_with_those_that_exist(cell: Cell) -> None:
    with pytest.raises(zarm.InvalidRequest, match="panda has no gripper claw, but hand"):
        cell.robot.gripper.state("claw")
    assert set(cell.robot.gripper.all()) == {"hand"}
    status = run_zarm("status", ZARM_CONNECT=cell.endpoint)
    assert "open 0.080 m, reached" in status.stdout


@pytest.fixture
def driven(tmp_path: Path) -> Path:
    """The descriptor of a Panda with a driver."""
    for suffix in (".yaml", ".urdf"):
        shutil.copy(ROBOTS / f"panda{suffix}", tmp_path)
    path = tmp_path / "panda.yaml"
    text = path.read_text().replace("strategy: emulator\n", "strategy: joint_trajectory\n")
    path.write_text(text.replace("  strategies: [joint_trajectory]\n", ""))
    return path


@contextmanager
def finger_driver(bus: Bus, stop_at: float) -> Iterator[list[DriverGripperCommand]]:
    """Reports the joints of a Panda, and moves its fingers at once, but never below `stop_at` (m); yields its commands."""
    joints = (*PANDA.descriptor.joints, "panda_finger_joint1")
    finger, commands, ended = [0.04], list[DriverGripperCommand](), threading.Event()

    def receive(_: str, command: DriverGripperCommand) -> None:
        commands.append(command)

    def run() -> None:
        states = bus.publisher(KEYS.driver_joint_states)
        while not ended.wait(0.01):
            if commands:
                step = 0.002
                finger[0] += min(max(max(commands[-1].position, stop_at) - finger[0], -step), step)
            states.put(
                JointState(
                    stamp=time.time(),
                    joint_names=joints,
                    position=(*HOME, finger[0]),
                    velocity=(0.0,) * len(joints),
                )
            )

    end = bus.subscribe(KEYS.driver_gripper_command, receive)
    thread = threading.Thread(target=run)
    thread.start()
    try:
        yield commands
    finally:
        end()
        ended.set()
        thread.join()


def test_fingers_that_meet_an_object_stall_and_hold_it(driven: Path, tmp_path: Path) -> None:
    with ExitStack() as stack:
        endpoint = stack.enter_context(router())
        bus = stack.enter_context(Bus(endpoint))
        commands = stack.enter_context(finger_driver(bus, 0.015))
        process = stack.enter_context(ServiceProcess("executor", endpoint, tmp_path, str(driven)))
        process.wait_ready(bus, KEYS)
        robot = stack.enter_context(zarm.connect(endpoint))
        held = robot.gripper.close(force=30.0, speed=0.05)
        assert (held.status, held.width) == ("stalled", pytest.approx(0.03))
        (command,) = commands
        assert (command.position, command.speed, command.force) == (0.0, pytest.approx(0.025), 30.0)
        assert robot.gripper.open().status == "reached"


def test_the_simulated_driver_has_fingers_that_an_object_stops(driven: Path, tmp_path: Path) -> None:
    with ExitStack() as stack:
        endpoint = stack.enter_context(router())
        bus = stack.enter_context(Bus(endpoint))
        for service in ("leeloo_sim", "executor"):
            process = ServiceProcess(service, endpoint, tmp_path, str(driven))
            stack.enter_context(process).wait_ready(bus, KEYS)
        robot = stack.enter_context(zarm.connect(endpoint))
        bus.call(KEYS.simulated_fault, DriverFault(obstacle=0.03), timeout=PATIENCE)
        held = robot.gripper.close()
        assert (held.status, held.width) == ("stalled", pytest.approx(0.03, abs=1e-4))
        assert robot.gripper.close().status == "stalled", "it still holds"
        bus.call(KEYS.simulated_fault, DriverFault(), timeout=PATIENCE)
        assert robot.gripper.close().status == "reached"
        assert robot.gripper.open().width == pytest.approx(0.08, abs=1e-3)


def test_a_gripper_whose_driver_is_silent_ends_with_a_reason(driven: Path, tmp_path: Path) -> None:
    with ExitStack() as stack:
        endpoint = stack.enter_context(router())
        bus = stack.enter_context(Bus(endpoint))
        process = ServiceProcess("executor", endpoint, tmp_path, str(driven), arguments=("--strategy", "emulator"))
        stack.enter_context(process).wait_ready(bus, KEYS)
        robot = stack.enter_context(zarm.connect(endpoint))
        with finger_driver(bus, 0.0) as commands:
            eventually(lambda: robot.strategy().strategies[2].available, "the driver is seen")
            robot.strategy("joint_trajectory")
            assert robot.gripper.close().status == "reached"
            assert commands
        with pytest.raises(zarm.ExecutionFailed, match="has reported nothing for 2 s"):
            robot.gripper.open()
        reports = bus.publisher(KEYS.driver_gripper_state)
        goal = bus.call(KEYS.gripper, GripperRequest(width=0.08), timeout=PATIENCE).goal_id
        reports.put(DriverGripperState(gripper="hand", sequence=3, problem="the gripper has no power"))
        ended = next(state for state in robot.gripper.states() if state.goal_id == goal and state.done)
        assert ended.problem is not None
        assert "the gripper has no power" in ended.problem.message


def test_the_scale_of_positions_is_kept_over_a_restart(tmp_path: Path) -> None:
    with router() as endpoint, Bus(endpoint) as bus:
        for width in (0.05, 0.02):
            with (
                ServiceProcess("executor", endpoint, tmp_path, "panda") as process,
                zarm.connect(endpoint, "panda") as robot,
            ):
                process.wait_ready(bus, KEYS)
                if width == 0.02:
                    assert robot.gripper.state().width == pytest.approx(0.05, abs=1e-3)
                robot.gripper.move(width)
    assert np.isclose(width, 0.02)
