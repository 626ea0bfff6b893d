"""Digital outputs: switched by clients and by programs, and never without their driver's word."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest

import zarm
from support.command_line import zarm as run_zarm
from support.harness import PATIENCE, ServiceProcess, eventually, router
from support.outputs import M1013, with_outputs
from zarm_contract.keys import Keys
from zarm_contract.messages import DriverFault, JointState
from zarm_runtime.bus import Bus

KEYS = Keys(M1013.descriptor.name)
HOME = M1013.descriptor.home
AWAY = (HOME[0] + 0.3, *HOME[1:])


@contextmanager
def cell(folder: Path, *services: str, strategy: str = "emulator") -> Iterator[tuple[zarm.Robot, Bus, str]]:
    """These services with that robot, a client, and their bus."""
    with ExitStack() as stack:
        endpoint = stack.enter_context(router())
        bus = stack.enter_context(Bus(endpoint))
        for service in services:
            arguments = ("--strategy", strategy) if service == "executor" else ()
            process = ServiceProcess(service, endpoint, folder, with_outputs(folder), arguments=arguments)
            stack.enter_context(process).wait_ready(bus, KEYS)
        yield stack.enter_context(zarm.connect(endpoint)), bus, endpoint


def joints(bus: Bus) -> JointState:
    """The next joint state."""
    states = list[JointState]()
    end = bus.subscribe(KEYS.joint_states, lambda _, state: states.append(state))
    eventually(lambda: states, "the joints are reported")
    end()
    return states[0]


def test_output_is_switched_listed_and_refused_by_name(tmp_path: Path) -> None:
    with cell(tmp_path, "executor") as (robot, _, endpoint):
        assert {name: state.on for name, state in robot.outputs.all().items()} == {"vacuum": None, "torch": None}
        assert robot.outputs.set("vacuum", True).on is True
        done = run_zarm("output", "set", "torch", "off", "--json", ZARM_CONNECT=endpoint)
        assert json.loads(done.stdout) == {"outputs": [{"output": "torch", "on": False}]}
        assert {name: state.on for name, state in robot.outputs.all().items()} == {"vacuum": True, "torch": False}
        with pytest.raises(
            zarm.InvalidRequest, match="there is no output lamp; this robot has vacuum, torch"
        ) as refused:
            robot.outputs.set("lamp", True)
        assert refused.value.problem.field == "output"
        robot.stop()
        assert robot.outputs.all()["vacuum"].on is True, "a stop drops nothing"


def test_program_switches_outputs_at_rest_where_it_says(tmp_path: Path) -> None:
    with cell(tmp_path, "planner", "leeloo_sim", "executor", strategy="joint_pose") as (robot, bus, _):
        commands: list[tuple[float, str, bool]] = []
        measured: list[JointState] = []
        bus.subscribe(KEYS.joint_states, lambda _, state: measured.append(state))
        bus.subscribe(KEYS.driver_output_command, lambda _, one: commands.append((time.time(), one.output, one.on)))
        plan = robot.plan_program(
            [
                zarm.Move(AWAY),
                zarm.SetOutput("torch", True, name="light"),
                zarm.Move(HOME),
                zarm.SetOutput("torch", False),
            ]
        )
        assert [segment.action for segment in plan.segments] == ["move", "set_output", "move", "set_output"]
        assert robot.execute(plan).status == "succeeded"
        assert [command[1:] for command in commands] == [("torch", True), ("torch", False)]
        for (at, *_), target in zip(commands, (AWAY, HOME), strict=True):
            then = min(measured, key=lambda state: abs(state.stamp - at))
            assert then.position == pytest.approx(target, abs=2e-3)
            assert max(map(abs, then.velocity)) < 0.01
        with pytest.raises(zarm.InvalidRequest, match="there is no output lamp") as refused:
            robot.plan_program([zarm.Move(AWAY), zarm.SetOutput("lamp", True)])
        assert refused.value.problem.field == "segments.1.output"


def test_goal_ends_where_its_output_is_not_switched(tmp_path: Path) -> None:
    with cell(tmp_path, "planner", "leeloo_sim", "executor", strategy="joint_pose") as (robot, bus, _):
        plan = robot.plan_program([zarm.Move(AWAY), zarm.SetOutput("torch", True), zarm.Move(HOME)])
        bus.call(KEYS.simulated_fault, DriverFault(output="torch"), timeout=PATIENCE)
        with pytest.raises(zarm.ExecutionFailed, match="torch was not switched: torch has no power"):
            robot.execute(plan)
        assert joints(bus).position[0] == pytest.approx(AWAY[0], abs=2e-3)
        state = robot.outputs.all()["torch"]
        assert state.on is None
        assert state.problem is not None
        bus.call(KEYS.simulated_fault, DriverFault(), timeout=PATIENCE)
        assert robot.outputs.set("torch", True).on is True


def test_output_whose_driver_is_silent_says_so(tmp_path: Path) -> None:
    with cell(tmp_path, "leeloo_sim", "executor", strategy="joint_pose") as (robot, bus, _):
        bus.call(KEYS.simulated_fault, DriverFault(silent=True), timeout=PATIENCE)
        with pytest.raises(zarm.ExecutionFailed, match=r"the driver did not confirm torch within 0\.5 s"):
            robot.outputs.set("torch", True)
