"""Each service is replaced while the others run: what moves is not disturbed, and no client is told what is not so."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path

import numpy as np
import pytest

from support.executor.client import Client
from support.executor.driven import THERE, driven
from support.faults.askers import asking
from support.harness import PATIENCE, ServiceProcess, eventually, free_endpoint
from support.planner.client import BEHIND_POST, POST, TABLE, load, plan, to_joints
from support.resources import favour
from support.trajectories import HOME, KEYS, moved, rest_to_rest
from zarm_contract.errors import ExecutionRefused, Unavailable
from zarm_contract.messages import (
    FkRequest,
    Nothing,
    PlanRequest,
    SettingsChange,
    StrategyRequest,
)
from zarm_runtime.bus import Bus
from zarm_runtime.session import open_router

pytestmark = pytest.mark.slow

SLOW = rest_to_rest(moved(0.8), slower=6.0)


def ends_in_order(process: ServiceProcess) -> None:
    process.process.terminate()
    assert process.process.wait(PATIENCE) == 0
    assert "Traceback" not in process.output()


def test_a_planner_is_replaced_while_the_robot_moves(
    executor: ServiceProcess, client: Client, endpoint: str, bus: Bus, tmp_path: Path
) -> None:
    with ExitStack() as stack:
        old = stack.enter_context(ServiceProcess("planner", endpoint, tmp_path))
        old.wait_ready(bus, KEYS)
        loaded = load(bus, TABLE, POST)
        scene = bus.read(KEYS.scene, timeout=PATIENCE)
        settings = bus.call(KEYS.settings, SettingsChange(), timeout=PATIENCE)
        fk = FkRequest(joints=(tuple(HOME.tolist()),))
        tip = bus.call(KEYS.fk, fk, timeout=PATIENCE)
        way = PlanRequest(start=tuple(HOME.tolist()), goal=to_joints(*BEHIND_POST))
        askers = stack.enter_context(
            asking(
                plan=lambda: plan(bus, way).scene_revision == loaded.revision,
                scene=lambda: bus.read(KEYS.scene, timeout=PATIENCE) == scene,
                revision=lambda: bus.read(KEYS.scene_revision, timeout=PATIENCE) == loaded,
                settings=lambda: bus.call(KEYS.settings, SettingsChange(), timeout=PATIENCE) == settings,
                fk=lambda: bus.call(KEYS.fk, fk, timeout=PATIENCE) == tip,
            )
        )
        made = plan(bus, way)
        goal = client.execute(SLOW)
        client.under_way(goal, 0.05)
        ends_in_order(old)
        with pytest.raises(Unavailable, match="nobody answered"):
            plan(bus, way)
        new = stack.enter_context(ServiceProcess("planner", endpoint, tmp_path))
        new.wait_ready(bus, KEYS)
        assert client.ended(goal).status == "succeeded"
        eventually(lambda: client.statuses(goal) == ["accepted", "running", "succeeded"], "each state has been heard")
        client.ended(client.execute(rest_to_rest(HOME, moved(0.8))))
        assert client.ended(client.execute(made.trajectory, scene_revision=made.scene_revision)).status == "succeeded"
        askers.all_right_again()


def test_an_executor_brakes_before_it_is_replaced(endpoint: str, bus: Bus, tmp_path: Path) -> None:
    with ExitStack() as stack:
        old = stack.enter_context(ServiceProcess("executor", endpoint, tmp_path))
        old.wait_ready(bus, KEYS)
        client = Client(bus)
        askers = stack.enter_context(
            asking(
                state=lambda: client.state().strategy == "emulator",
                strategy=lambda: bus.call(KEYS.strategy, StrategyRequest(), timeout=PATIENCE).active == "emulator",
                speed=lambda: client.speed() == 1.0,
            )
        )
        goal = client.execute(SLOW)
        client.under_way(goal)
        ends_in_order(old)
        (ended,) = [state for state in client.goals if state.goal_id == goal and state.done]
        assert ended.status == "cancelled"
        assert ended.problem is not None
        assert "the executor was told to end" in ended.problem.message
        assert client.greatest_acceleration() < 1.02
        rested = client.measured[-1]
        assert not any(rested.velocity)
        with pytest.raises(Unavailable, match="nobody answered"):
            client.execute(SLOW)
        new = stack.enter_context(ServiceProcess("executor", endpoint, tmp_path))
        new.wait_ready(bus, KEYS)
        np.testing.assert_array_equal(client.position(), rested.position)
        assert client.ended(client.execute(rest_to_rest(HOME, client.position()))).status == "succeeded"
        askers.all_right_again()


def test_a_driver_is_replaced_while_the_robot_rests(endpoint: str, bus: Bus, tmp_path: Path) -> None:
    with driven(bus, endpoint, tmp_path, "joint_speed") as arm, ExitStack() as stack:
        questions = {"state": lambda: arm.client.state().mode == "idle", "speed": lambda: arm.client.speed() == 1.0}
        with asking(**questions) as askers:
            ends_in_order(arm.driver)
            eventually(lambda: not _available(bus), "the executor misses the driver")
            with pytest.raises(ExecutionRefused, match="check that the robot's driver runs"):
                arm.client.execute(THERE)
            new = stack.enter_context(arm.new_driver())
            new.wait_ready(bus, KEYS)
            favour(new, arm.executor)
            eventually(lambda: _available(bus), "the executor hears the driver")
            askers.all_right_again()
        assert arm.client.ended(arm.client.execute(THERE)).status == "succeeded"


def _available(bus: Bus) -> bool:
    strategies = bus.call(KEYS.strategy, StrategyRequest(), timeout=PATIENCE).strategies
    return any(one.available for one in strategies if one.name == "joint_speed")


def test_a_router_is_replaced_while_the_robot_moves(tmp_path: Path) -> None:
    endpoint = free_endpoint()
    with ExitStack() as stack:
        old = stack.enter_context(ExitStack())
        old.enter_context(open_router(endpoint))
        bus = stack.enter_context(Bus(endpoint))
        services = [stack.enter_context(ServiceProcess(name, endpoint, tmp_path)) for name in ("planner", "executor")]
        before = [service.wait_ready(bus, KEYS) for service in services]
        load(bus, TABLE, POST)
        scene = bus.read(KEYS.scene, timeout=PATIENCE)
        client = Client(bus)
        askers = stack.enter_context(
            asking(
                scene=lambda: bus.read(KEYS.scene, timeout=PATIENCE) == scene,
                state=lambda: client.state().strategy == "emulator",
            )
        )
        goal = client.execute(SLOW)
        client.under_way(goal, 0.05)
        old.close()
        with pytest.raises(Unavailable):
            client.execute(SLOW)
        stack.enter_context(open_router(endpoint))
        eventually(lambda: _instances(bus) == {health.instance for health in before}, "both are back, and the same")
        assert client.ended(goal).status == "succeeded"
        np.testing.assert_allclose(client.position(), moved(0.8), atol=1e-6)
        askers.all_right_again()


def _instances(bus: Bus) -> set[str] | None:
    try:
        return {
            bus.call(KEYS.health(service), Nothing(), timeout=PATIENCE).instance for service in ("planner", "executor")
        }
    except Unavailable:
        return None
