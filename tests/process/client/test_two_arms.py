"""Two arms on one bus: each moves alone, both move together, one hands over to the other, and the servo watches and leads them."""

from __future__ import annotations

import itertools
import json
import re
import signal
import subprocess
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import pytest

import zarm
from support.command_line import ZARM, environment
from support.command_line import zarm as zarm_cli
from support.composed import two_pandas
from support.example_programs import run_example
from support.harness import PATIENCE, ServiceProcess, eventually, router
from zarm_contract.errors import InvalidRequest
from zarm_contract.keys import Keys
from zarm_contract.messages import Continuation, ExecuteRequest
from zarm_runtime.bus import Bus

DOWN = (1.0, 0.0, 0.0, 0.0)
LEFT, RIGHT = slice(7), slice(7, 14)
HOME = (0.0, -0.785398, 0.0, -2.356194, 0.0, 1.570796, 0.785398)


class Cell:
    """Two Pandas, their planner, executor and servo, and a client."""

    def __init__(self, stack: ExitStack, tmp_path_factory: pytest.TempPathFactory) -> None:
        folder = tmp_path_factory.mktemp("cell")
        self.endpoint = stack.enter_context(router())
        bus = stack.enter_context(Bus(self.endpoint))
        robot = str(two_pandas(tmp_path_factory.mktemp("robot")))
        for service in ("planner", "executor", "servo"):
            process = ServiceProcess(service, self.endpoint, folder, robot)
            stack.enter_context(process).wait_ready(bus, Keys("pandas"))
        self.robot = stack.enter_context(zarm.connect(self.endpoint))


@pytest.fixture(scope="module")
def cell(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cell]:
    with ExitStack() as stack:
        yield Cell(stack, tmp_path_factory)


@pytest.fixture
def robot(cell: Cell) -> zarm.Robot:
    """The robot at home, in an empty scene, with open grippers."""
    for name in cell.robot.scene.attached():
        cell.robot.scene.detach(name)
    cell.robot.scene.clear()
    for gripper in ("left_hand", "right_hand"):
        cell.robot.gripper.open(gripper)
    cell.robot.execute(cell.robot.plan((*HOME, *HOME)))
    return cell.robot


def positions(robot: zarm.Robot) -> np.ndarray:  # type: ignore[type-arg]
    return np.array(robot.joint_state().position)


def test_one_arm_moves_and_the_other_stands(robot: zarm.Robot) -> None:
    before = positions(robot)
    robot.execute(robot.plan(zarm.Pose((0.45, -0.25, 0.3), DOWN), group="right"))
    assert robot.tip("right").position == pytest.approx((0.45, -0.25, 0.3), abs=1e-3)
    assert positions(robot)[LEFT] == pytest.approx(before[LEFT], abs=1e-9)


def test_both_arms_move_at_once(robot: zarm.Robot) -> None:
    robot.execute(robot.plan({"left": zarm.Pose((0.45, 0.2, 0.35), DOWN), "right": HOME}))
    assert robot.tip("left").position == pytest.approx((0.45, 0.2, 0.35), abs=1e-3)
    state = robot.execute(
        robot.plan({"left": zarm.Pose((0.4, 0.3, 0.5), DOWN), "right": zarm.Pose((0.4, -0.3, 0.3), DOWN)})
    )
    assert state.status == "succeeded"
    assert robot.tip("left").position == pytest.approx((0.4, 0.3, 0.5), abs=1e-3)
    assert robot.tip("right").position == pytest.approx((0.4, -0.3, 0.3), abs=1e-3)


def test_an_arm_joins_in_while_the_other_moves(robot: zarm.Robot) -> None:
    states: list[np.ndarray] = []  # type: ignore[type-arg]
    first = robot.plan(zarm.Pose((0.45, 0.45, 0.4), DOWN), group="left", velocity_scale=0.2)
    goal_id = robot.start(first)
    end = robot.connection.bus.subscribe(
        robot.connection.keys.joint_states, lambda _, state: states.append(np.array(state.position))
    )
    last = robot.execute_alongside(zarm.Pose((0.45, -0.45, 0.4), DOWN), group="right")
    end()
    assert (last.goal_id, last.status) == (goal_id, "succeeded")
    assert robot.tip("left").position == pytest.approx((0.45, 0.45, 0.4), abs=1e-3)
    assert robot.tip("right").position == pytest.approx((0.45, -0.45, 0.4), abs=1e-3)
    moves = [np.abs(after - before) > 1e-5 for before, after in itertools.pairwise(states)]
    assert any(moved[LEFT].any() and moved[RIGHT].any() for moved in moves), "both move at once"


def test_the_servo_holds_both_arms_before_what_appears(robot: zarm.Robot) -> None:
    goal_id = robot.start(robot.plan(zarm.Pose((0.45, 0.65, 0.4), DOWN), group="left", velocity_scale=0.1))
    goal, held = zarm.Pose((0.45, -0.65, 0.35), DOWN), []

    def look(state: zarm.GoalState) -> None:
        if state.progress > 0.1 and not held and "ball" not in robot.scene.objects():
            robot.scene.add(zarm.Sphere("ball", radius=0.05, position=goal.position))
        if state.hold is not None and not held:
            held.append(state.hold.reason)
            robot.scene.remove("ball")

    last = robot.execute_alongside(goal, look, group="right", velocity_scale=0.1)
    assert held == ["obstruction"]
    assert (last.goal_id, last.status) == (goal_id, "succeeded")
    assert robot.tip("left").position == pytest.approx((0.45, 0.65, 0.4), abs=1e-3)
    assert robot.tip("right").position == pytest.approx(goal.position, abs=1e-3)


def test_an_interruption_of_who_joined_in_stops_both_arms(cell: Cell, robot: zarm.Robot) -> None:
    goal_id = robot.start(robot.plan(zarm.Pose((0.45, 0.65, 0.4), DOWN), group="left", velocity_scale=0.05))
    command = ("execute", "--alongside", "--group", "right", "--to", "0.45,-0.65,0.35", "--velocity-scale", "0.05")
    with subprocess.Popen(
        [ZARM, *command], env=environment(ZARM_CONNECT=cell.endpoint), stderr=subprocess.PIPE
    ) as process:
        eventually(lambda: np.ptp([positions(robot)[RIGHT], HOME], axis=0).max() > 1e-3, "the right arm moves")
        process.send_signal(signal.SIGINT)
        assert process.wait(PATIENCE) != 0
    assert robot.follow(goal_id).status == "cancelled"
    assert robot.state().mode == "idle"


def test_an_arm_that_joins_in_waits_for_the_other(robot: zarm.Robot) -> None:
    robot.execute(robot.plan(zarm.Pose((0.5, -0.05, 0.35), DOWN), group="left"))
    robot.start(robot.plan(HOME, group="left", velocity_scale=0.2))
    last = robot.execute_alongside(zarm.Pose((0.5, -0.05, 0.35), DOWN), group="right")
    assert last.status == "succeeded"
    assert robot.tip("right").position == pytest.approx((0.5, -0.05, 0.35), abs=1e-3)
    assert positions(robot)[LEFT] == pytest.approx(HOME, abs=1e-3)


def test_without_a_goal_alongside_is_a_motion_of_its_own(robot: zarm.Robot) -> None:
    last = robot.execute_alongside(zarm.Pose((0.45, -0.45, 0.4), DOWN), group="right")
    assert last.status == "succeeded"
    assert robot.tip("right").position == pytest.approx((0.45, -0.45, 0.4), abs=1e-3)


def test_a_joint_of_the_running_goal_is_not_given_to_another(robot: zarm.Robot) -> None:
    goal_id = robot.start(robot.plan(zarm.Pose((0.45, 0.45, 0.4), DOWN), group="left", velocity_scale=0.2))
    with pytest.raises(InvalidRequest, match=r"left_panda_joint\d moves there already"):
        robot.execute_alongside(zarm.Pose((0.4, 0.3, 0.4), DOWN), group="left")
    assert robot.follow(goal_id).status == "succeeded"


def test_a_plan_that_does_not_go_on_where_the_goal_is_is_refused(robot: zarm.Robot) -> None:
    other = robot.plan(zarm.Pose((0.45, -0.45, 0.4), DOWN), group="right")
    goal_id = robot.start(robot.plan(zarm.Pose((0.45, 0.45, 0.4), DOWN), group="left", velocity_scale=0.2))
    for number, at, says in (
        (7, 0.8, "trajectory 7 of .* is not active"),
        (1, 0.8, "does not begin where the one before is"),
        (1, 0.0, "committed until"),
    ):
        where = Continuation(goal_id=goal_id, number=number, at=at)
        with pytest.raises(zarm.Error, match=says):
            robot.connection.ask(robot.connection.keys.execute, ExecuteRequest(plan_id=other.plan_id, continues=where))
    assert robot.follow(goal_id).status == "succeeded"
    assert positions(robot)[RIGHT] == pytest.approx(HOME, abs=1e-3)


def test_nothing_joins_a_session_of_the_servo(robot: zarm.Robot) -> None:
    with robot.track() as tracking:
        tracking.to(zarm.Pose((0.4, 0.3, 0.4), DOWN), group="left")
        eventually(lambda: robot.state().goal_id is not None, "the session leads the robot")
        with pytest.raises(zarm.Error, match="has not ended the goal"):
            robot.execute_alongside(zarm.Pose((0.45, -0.45, 0.4), DOWN), group="right")


def test_one_arm_hands_a_bar_over_to_the_other(cell: Cell, robot: zarm.Robot) -> None:
    assert run_example("15_hand_over", cell.endpoint) == "left_panda_hand holds the bar\n"
    robot.scene.detach("bar")
    bar = robot.scene.objects()["bar"]
    assert bar.position == pytest.approx((0.45, 0.3 - 0.11, 0.4), abs=3e-3)  # type: ignore[union-attr]


def test_two_arms_carry_a_tray(cell: Cell, robot: zarm.Robot) -> None:
    said = run_example("17_tray", cell.endpoint)
    assert re.findall(r"the hands are ([\d.]+) m apart", said) == ["0.400", "0.400"]
    assert robot.scene.attached()["tray"].link == "left_panda_hand"
    robot.scene.detach("tray")
    assert robot.scene.objects()["tray"].position == pytest.approx((0.4, 0.1, 0.2), abs=3e-3)  # type: ignore[union-attr]


def test_the_servo_holds_an_arm_before_what_appears_in_its_way(robot: zarm.Robot) -> None:
    plan = robot.plan(zarm.Pose((0.45, -0.65, 0.35), DOWN), group="right", velocity_scale=0.1, acceleration_scale=0.1)
    x, y, z = robot.fk([plan.trajectory.position[-1]], group="right")[0].position
    goal_id = robot.start(plan)
    robot.scene.add(zarm.Sphere("ball", radius=0.05, position=(x, y, z)))
    held = next(state.hold for state in robot.executor.goal_states(goal_id) if state.hold is not None)
    assert held.reason == "obstruction"
    robot.scene.remove("ball")
    last = robot.follow(goal_id)
    assert last.status == "succeeded"


def test_the_servo_leads_one_tip(robot: zarm.Robot) -> None:
    before = positions(robot)
    with robot.track() as tracking:
        tracking.reach(zarm.Pose((0.4, -0.25, 0.4), DOWN), group="right", timeout=30.0)
        assert tracking.state is not None
        tracking.to(zarm.Pose((0.4, -0.25, 0.4), DOWN))
        eventually(
            lambda: tracking.state is not None and tracking.state.refused is not None,
            "a pose without a group is refused",
        )
        assert "name one of the groups left, right" in tracking.state.refused.message  # type: ignore[union-attr]
    assert robot.tip("right").position == pytest.approx((0.4, -0.25, 0.4), abs=2e-3)
    assert positions(robot)[LEFT] == pytest.approx(before[LEFT], abs=1e-6)


def test_the_command_line_moves_groups(cell: Cell, robot: zarm.Robot, tmp_path: Path) -> None:
    def done(*arguments: str) -> str:
        result = zarm_cli(*arguments, ZARM_CONNECT=cell.endpoint)
        assert result.returncode == 0, result.stderr
        return result.stdout

    done("execute", "--group", "left", "--to", "0.45,0.25,0.3")
    assert robot.tip("left").position == pytest.approx((0.45, 0.25, 0.3), abs=1e-3)
    done("execute", "--to", "left=0.4,0.3,0.4", "--to", "right=0.4,-0.3,0.4")
    assert robot.tip("right").position == pytest.approx((0.4, -0.3, 0.4), abs=1e-3)
    robot.start(robot.plan(zarm.Pose((0.45, 0.45, 0.4), DOWN), group="left", velocity_scale=0.2))
    done("execute", "--alongside", "--group", "right", "--to", "0.4,-0.4,0.5")
    assert robot.tip("left").position == pytest.approx((0.45, 0.45, 0.4), abs=1e-3)
    assert robot.tip("right").position == pytest.approx((0.4, -0.4, 0.5), abs=1e-3)
    done("execute", "--to", "left=0.4,0.2,0.4", "--to", "right=0.4,-0.2,0.4")
    follows, plan = ("--hold-group", "right", "--relative-to", "left"), str(tmp_path / "tray.json")
    done("plan", "--group", "left", "--to", "0.5,0.3,0.5", *follows, "--save", plan)
    done("execute", "--plan", plan)
    assert robot.tip("right").position == pytest.approx((0.5, -0.1, 0.5), abs=1e-3)
    done("execute", "--group", "right", "--to", "0.4,-0.3,0.4")
    tip = json.loads(done("fk", "--group", "right", "--json"))["poses"][0]
    assert tip["position"] == pytest.approx((0.4, -0.3, 0.4), abs=1e-3)


def test_what_names_no_tip_is_refused(robot: zarm.Robot) -> None:
    for refused in (
        lambda: robot.plan(zarm.Pose((0.4, 0.3, 0.4))),
        lambda: robot.tip(),
        lambda: robot.ik(zarm.Pose((0.4, 0.3, 0.4))),
    ):
        with pytest.raises(InvalidRequest, match="name one of the groups left, right"):
            refused()
