"""Every command of `zarm`, run as a person runs it: what it does, what it prints, how it fails."""

from __future__ import annotations

import json
import math
import os
import pty
import signal
import subprocess
from contextlib import suppress
from pathlib import Path
from queue import SimpleQueue

import pytest

from support.command_line import (
    HOME,
    KEYS,
    ROBOT,
    ZARM,
    Command,
    Up,
    data,
    done,
    environment,
    health,
    refused,
    the_one_line,
    vector,
    zarm,
)
from support.harness import PATIENCE, eventually
from zarm_contract.messages import GoalState, JointState
from zarm_runtime.bus import Bus

DOWN = "0,1,0,0"
"""The orientation (x, y, z, w) of a tool that points down."""
SLOWLY = ("--velocity-scale", "0.12")
"""For motions that must not be over before a test has done something to them."""


def near_home(first: float) -> str:
    """Home with the first joint (rad) elsewhere."""
    return vector((first, *HOME[1:]))


# -- planning and moving --


def test_plan_finds_a_motion_to_a_pose_with_negative_numbers(up: Up, empty_scene: None) -> None:
    plan = data(up, "plan", "--to", f"-0.4,-0.4,0.5,{DOWN}", "--seed", "3")
    assert plan["tip"]["position"] == pytest.approx([-0.4, -0.4, 0.5], abs=1e-3)
    assert "clearance" in done(up, "plan", "--to", f"-0.4,-0.4,0.5,{DOWN}", "--seed", "3")


def test_a_position_alone_keeps_the_orientation_of_the_tool(up: Up, empty_scene: None) -> None:
    before = data(up, "fk")["poses"][0]["orientation"]
    plan = data(up, "plan", "--to", "0.5,0.2,0.5")
    cosine = abs(sum(a * b for a, b in zip(plan["tip"]["orientation"], before, strict=True)))
    assert cosine == pytest.approx(1.0, abs=1e-4)


def test_any_plans_to_the_pose_reached_soonest(up: Up, empty_scene: None) -> None:
    poses = ("--to", f"-0.4,-0.4,0.5,{DOWN}", "--to", f"5,0,0.5,{DOWN}", "--to", f"0.5,0.2,0.5,{DOWN}")
    plan = data(up, "plan", *poses, "--any", "--start", vector(HOME))
    assert plan["selected_goal_index"] == 2
    assert plan["tip"]["position"] == pytest.approx([0.5, 0.2, 0.5], abs=1e-3)
    assert "--to number 2 of 3" in done(up, "plan", *poses, "--any", "--start", vector(HOME))


def test_free_components_and_tolerances_of_a_pose_are_used(up: Up, empty_scene: None) -> None:
    free = data(up, "plan", "--to", "0.5,0.2,0.5", "--free", "theta_x,theta_y,theta_z", "--start", vector(HOME))
    assert free["tip"]["position"] == pytest.approx([0.5, 0.2, 0.5], abs=1e-4)
    assert len(free["goal_deviation"]) == 6
    boxed = data(
        up, "plan", "--to", f"0.5,0.2,0.5,{DOWN}", "--tolerance", "x=0.02,theta_z=0.3", "--start", vector(HOME)
    )
    assert abs(boxed["goal_deviation"][3]) <= 0.02
    solutions = data(up, "ik", "--to", f"0.5,0.2,0.5,{DOWN}", "--free", "theta_z", "--near", vector(HOME))
    assert solutions["solutions"][0]
    assert "--tolerance" in refused(up, "plan", "--to", "0.5,0.2,0.5", "--tolerance", "roll=0.1", code=2)
    assert "--free" in refused(up, "plan", "--joints", vector(HOME), "--free", "theta_z", code=2)


def test_a_line_is_planned_at_the_speed_of_the_tool(up: Up, empty_scene: None) -> None:
    x, y, z = data(up, "fk", "--joints", vector(HOME))["poses"][0]["position"]
    line = ("plan", "--to", f"{x},{y + 0.2},{z}", "--line", "--speed", "0.05", "--start", vector(HOME))
    plan = data(up, *line, "--free", "theta_z")
    assert plan["tool"]["speed"] == 0.05
    assert plan["tool"]["length"] == pytest.approx(0.2, abs=1e-4)
    assert "at 0.05 m/s" in done(up, *line)
    around = ("--via", f"{x + 0.07},{y + 0.1},{z}", "--orienting", "tangent")
    assert data(up, "plan", "--to", f"{x},{y + 0.2},{z}", *around, "--start", vector(HOME))["tool"]["length"] > 0.2
    corner = ("--to", f"{x},{y + 0.2},{z}", "--to", f"{x},{y + 0.2},{z - 0.1}", "--line", "--blend", "0.02")
    assert data(up, "plan", *corner, "--start", vector(HOME))["tool"]["length"] == pytest.approx(0.3, abs=0.01)
    assert "% of its way" in refused(up, "plan", "--to", f"5,{y},{z}", "--line", "--start", vector(HOME))
    assert "--line" in refused(up, "plan", "--to", f"{x},{y},{z}", "--speed", "0.1", code=2)


def test_plan_takes_start_timeout_and_velocity_scale(up: Up, empty_scene: None) -> None:
    arguments = ("plan", "--start", vector(HOME), "--joints", near_home(-0.4), "--timeout", "3")
    fast, slow = data(up, *arguments), data(up, *arguments, "--velocity-scale", "0.2")
    assert fast["trajectory"]["position"][0] == pytest.approx(HOME, abs=1e-5)
    assert slow["trajectory"]["time"][-1] > fast["trajectory"]["time"][-1]


def test_a_pose_out_of_reach_is_said_in_one_line(up: Up) -> None:
    assert "unreachable" in refused(up, "plan", "--to", f"5,0,0.5,{DOWN}")


def test_a_wrong_number_of_joints_is_refused_by_name(up: Up) -> None:
    assert "invalid_request" in refused(up, "plan", "--joints", "0,0")


def test_execute_moves_along_the_last_plan(up: Up, observer: Bus, empty_scene: None) -> None:
    done(up, "plan", "--joints", near_home(0.2))
    assert "succeeded" in done(up, "execute")
    assert measured(observer)[0] == pytest.approx(0.2, abs=0.01)


def test_execute_plans_and_moves_in_one_go(up: Up, observer: Bus, empty_scene: None) -> None:
    last = data(up, "execute", "--joints", near_home(-0.1), "--velocity-scale", "0.9")
    assert last["status"] == "succeeded"
    assert last["plan_id"].startswith("p-")
    assert measured(observer)[0] == pytest.approx(-0.1, abs=0.01)
    tip = data(up, "fk")["poses"][0]["position"]
    goal = vector((tip[0], tip[1], tip[2] + 0.05))
    assert data(up, "execute", "--to", goal)["status"] == "succeeded"
    assert data(up, "fk")["poses"][0]["position"][2] == pytest.approx(tip[2] + 0.05, abs=0.002)


def test_a_saved_plan_can_be_executed_later(up: Up, observer: Bus, empty_scene: None, tmp_path: Path) -> None:
    done(up, "execute", "--joints", near_home(0.0))
    file = tmp_path / "plan.json"
    plan = data(up, "plan", "--joints", near_home(0.15), "--save", str(file))
    assert json.loads(file.read_text())["plan_id"] == plan["plan_id"]
    done(up, "plan", "--joints", near_home(-0.3))
    done(up, "execute", "--plan", str(file))
    assert measured(observer)[0] == pytest.approx(0.15, abs=0.01)


@pytest.mark.slow  # as in executor/test_plans.py
def test_a_published_plan_can_be_executed_by_its_id(up: Up, observer: Bus, empty_scene: None) -> None:
    done(up, "execute", "--joints", near_home(0.0))
    first = data(up, "plan", "--joints", near_home(0.1))
    done(up, "plan", "--joints", near_home(-0.3))
    done(up, "execute", "--plan-id", first["plan_id"])
    assert measured(observer)[0] == pytest.approx(0.1, abs=0.01)
    assert "nosuchplan" in refused(up, "execute", "--plan-id", "nosuchplan")


def test_the_table_of_services_is_whole_in_a_narrow_terminal(up: Up, observer: Bus) -> None:
    shown = zarm("status", ZARM_CONNECT=up.endpoint, COLUMNS="40")
    assert shown.returncode == 0, shown.stderr
    assert max(len(line) for line in shown.stdout.splitlines()) <= 40
    for service in ("planner", "executor"):
        found = health(observer, service)
        assert found is not None
        assert {service, str(found.pid), found.instance, found.robot_hash} <= set(shown.stdout.split())


def test_a_plan_of_another_scene_does_not_move_the_robot(up: Up, empty_scene: None, tmp_path: Path) -> None:
    file = str(tmp_path / "plan.json")
    done(up, "plan", "--joints", near_home(0.4), "--save", file)
    done(up, "scene", "add", "sphere", "ball", "--at", "0,-1,0.2", "--radius", "0.05")
    assert "stale_plan" in refused(up, "execute")
    assert "stale_plan" in refused(up, "execute", "--plan", file)


def test_a_file_that_holds_no_plan_is_named(up: Up, tmp_path: Path) -> None:
    file = tmp_path / "plan.json"
    assert str(file) in refused(up, "execute", "--plan", str(file))
    file.write_text("{}")
    assert str(file) in refused(up, "execute", "--plan", str(file))


def test_ctrl_c_during_execute_cancels_and_waits_for_rest(
    up: Up, observer: Bus, empty_scene: None, tmp_path: Path
) -> None:
    done(up, "execute", "--joints", near_home(0.0))
    goals: list[GoalState] = []
    observer.subscribe(KEYS.goal("*"), lambda _, goal: goals.append(goal))
    arguments = ("execute", "--joints", near_home(1.2), *SLOWLY, "--connect", up.endpoint)
    with Command(*arguments, folder=tmp_path) as execute:
        eventually(lambda: goals and goals[-1].progress > 0.1, "the robot is on its way")
        execute.interrupt()
        execute.interrupt()  # a second one changes nothing but that it is said what is waited for
        assert execute.end() == 130
        assert "the robot stands still" in execute.errors().splitlines()[-1]
    assert mode(observer) == "idle"
    assert 0.0 < measured(observer)[0] < 1.15
    eventually(lambda: goals[-1].status == "cancelled", "the goal is reported as cancelled")


def measured(bus: Bus) -> tuple[float, ...]:
    """The next measured joints (rad)."""
    states: SimpleQueue[JointState] = SimpleQueue()
    end = bus.subscribe(KEYS.joint_states, lambda _, state: states.put(state))
    try:
        return states.get(timeout=5).position
    finally:
        end()


def mode(bus: Bus) -> str:
    """What the executor does now."""
    return bus.read(KEYS.executor_state, timeout=5).mode


# -- the executor --


def test_stop_cancel_pause_resume_and_reset_print_the_state(up: Up) -> None:
    for order in ("stop", "cancel", "pause", "resume", "reset"):
        assert data(up, order)["mode"] == "idle"
    assert done(up, "stop").startswith("idle")


@pytest.mark.slow  # the commands are sent above; what they do is in unit/executor/test_machine.py
def test_pause_holds_a_motion_and_resume_ends_it(up: Up, observer: Bus, empty_scene: None, tmp_path: Path) -> None:
    done(up, "execute", "--joints", near_home(0.0))
    arguments = ("execute", "--joints", near_home(0.5), *SLOWLY, "--connect", up.endpoint)
    with Command(*arguments, folder=tmp_path) as execute:
        eventually(lambda: mode(observer) == "running", "the robot moves")
        done(up, "pause")
        eventually(lambda: mode(observer) == "paused", "the robot is held")
        done(up, "resume")
        assert execute.end() == 0
    assert measured(observer)[0] == pytest.approx(0.5, abs=0.01)


@pytest.mark.slow  # as in client/test_robot.py
def test_cancel_from_elsewhere_fails_the_command_that_executes(
    up: Up, observer: Bus, empty_scene: None, tmp_path: Path
) -> None:
    done(up, "execute", "--joints", near_home(0.0))
    arguments = ("execute", "--joints", near_home(1.2), *SLOWLY, "--connect", up.endpoint)
    with Command(*arguments, folder=tmp_path) as execute:
        eventually(lambda: mode(observer) == "running", "the robot moves")
        done(up, "cancel")
        assert execute.end() == 1
        assert the_one_line(execute.errors()).startswith("zarm: cancelled: ")


@pytest.mark.slow  # as in executor/test_preemption.py
def test_a_goal_preempts_another_only_when_it_is_asked_to(
    up: Up, observer: Bus, empty_scene: None, tmp_path: Path
) -> None:
    done(up, "execute", "--joints", near_home(0.0))
    arguments = ("execute", "--joints", near_home(1.2), *SLOWLY, "--connect", up.endpoint)
    with Command(*arguments, folder=tmp_path) as execute:
        eventually(lambda: measured(observer)[0] > 0.1, "the robot is on its way")
        back = ("execute", "--joints", near_home(0.0))
        assert "cancel it or wait" in refused(up, *back)
        done(up, *back, "--preempt")
        assert execute.end() == 1
        assert the_one_line(execute.errors()).startswith("zarm: cancelled: ")
    assert measured(observer)[0] == pytest.approx(0.0, abs=0.01)


def test_speed_shows_and_sets_the_speed_scaling(up: Up, observer: Bus) -> None:
    assert data(up, "speed") == {"speed_scale": 1.0}
    assert done(up, "speed", "0.4") == "40% of the planned speed\n"
    assert data(up, "speed") == {"speed_scale": 0.4}
    assert "40% of the planned speed" in done(up, "status")
    assert "speed_scale" in refused(up, "speed", "0.01")
    assert data(up, "speed", "1") == {"speed_scale": 1.0}
    assert "planned speed" not in done(up, "status")


def test_strategy_shows_and_switches(up: Up) -> None:
    known = data(up, "strategy")
    assert known["active"] == "emulator"
    assert data(up, "strategy", "emulator")["active"] == "emulator"
    assert "* emulator" in done(up, "strategy")
    assert "telepathy" in refused(up, "strategy", "telepathy")


# -- looking --


def test_status_and_health_tell_what_runs(up: Up) -> None:
    status = data(up, "status")
    assert status["robot"] == ROBOT
    assert all(status["services"][service]["ready"] for service in ("planner", "executor"))
    assert status["executor"]["mode"] == "idle"
    assert "planner" in done(up, "status")
    assert data(up, "health", "planner")["service"] == "planner"
    assert "ready" in done(up, "health", "executor")
    assert "unavailable" in refused(up, "health", "nosuchservice", code=3)


def test_watch_prints_what_the_robot_does_line_by_line(up: Up, tmp_path: Path) -> None:
    with Command("watch", "--json", "--connect", up.endpoint, folder=tmp_path) as watch:
        eventually(lambda: watch.output().count("\n") >= 3, "three lines are there")
        watch.interrupt()
        assert watch.end() == 130
        look = json.loads(watch.output().splitlines()[2])
    assert look["state"]["mode"] == "idle"
    assert len(look["joints"]["position"]) == 6
    assert math.hypot(*look["tip"]["position"]) > 0.1


def test_watch_shows_a_picture_on_a_terminal(up: Up) -> None:
    ours, theirs = pty.openpty()
    with subprocess.Popen([ZARM, "watch", "--connect", up.endpoint], env=environment(), stdout=theirs) as watch:
        os.close(theirs)
        shown = b""
        while b"joint_6" not in shown:
            shown += os.read(ours, 4096)
        watch.send_signal(signal.SIGINT)
        drain(ours)
        assert watch.wait(PATIENCE) == 130
    os.close(ours)
    assert b"idle" in shown


def drain(descriptor: int) -> None:
    """Read a terminal until nobody is left who writes to it."""
    with suppress(OSError):
        while os.read(descriptor, 4096):
            pass


# -- nothing there --


def test_a_robot_that_is_not_there_is_unavailable(up: Up) -> None:
    assert "unavailable" in refused(up, "stop", "--name", "nobody", code=3)
    assert "--name" in refused(up, "stop", "--name", "No Name")
    result = zarm("status", "--name", "nobody", ZARM_CONNECT=up.endpoint)
    assert result.returncode == 3
    assert "does not answer" in result.stdout


# -- programs --

PROGRAM = """
segments:
  - kind: move
    name: over
    goal: {{kind: pose, position: [{x}, {y}, {z}], tolerance: {{orientation: [free, free, free]}}}}
  - {{kind: wait, duration: 0.2}}
  - kind: move
    name: down
    goal: {{kind: line, position: [{x}, {y}, {below}], speed: {speed}}}
"""


def program(folder: Path, up: Up, **values: object) -> str:
    x, y, z = data(up, "fk", "--joints", vector(HOME))["poses"][0]["position"]
    file = folder / "down.yaml"
    asked = {"x": x, "y": y + 0.1, "z": z, "below": z - 0.05, "speed": 0.2, **values}
    file.write_text(PROGRAM.format(**asked))
    return str(file)


def test_program_in_a_file_is_checked_and_run_as_one_goal(up: Up, empty_scene: None, tmp_path: Path) -> None:
    file = program(tmp_path, up)
    checked = data(up, "program", "check", file)
    assert [(one["action"], one.get("name")) for one in checked["segments"]] == [
        ("move", "over"),
        ("wait", None),
        ("move", "down"),
    ]
    table = done(up, "program", "check", file, "--start", vector(HOME))
    assert "over" in table
    assert "down" in table
    assert data(up, "program", "run", file)["status"] == "succeeded"


def test_fault_in_a_program_is_said_with_its_line(up: Up, empty_scene: None, tmp_path: Path) -> None:
    assert "down.yaml:9: " in refused(up, "program", "check", program(tmp_path, up, speed=-1))
    far = refused(up, "program", "check", program(tmp_path, up, below=-9.0))
    assert "down.yaml:7: " in far
    assert "segment 2, down: " in far
    assert "% of its way" in far
    assert "cannot read" in refused(up, "program", "run", str(tmp_path / "none.yaml"))
