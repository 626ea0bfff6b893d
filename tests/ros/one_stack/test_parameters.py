"""Parameters of the node as any client on ROS sees them: what they may be, and that they say what is."""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from rcl_interfaces.msg import ParameterType
from rclpy.parameter import Parameter, parameter_value_to_python
from rclpy.parameter_client import AsyncParameterClient

from curobo_msgs.srv import SetRobotStrategy
from support.harness import PATIENCE, eventually
from support.ros.node import answer
from support.ros.stack import KEYS, Stack
from zarm_contract.errors import Busy
from zarm_contract.messages import Cuboid, Cylinder, Sphere, Strategies, StrategyRequest
from zarm_contract.robot import find_robot

DEFAULTS: dict[str, Any] = {
    "robot": "arm",
    "robot_type": "emulator",
    "control_strategy": "emulator",
    "planner_type": "classic",
    "robot_config_file": str(find_robot("doosan_m1013")),
    "base_link": "base_link",
    "world_file": "",
    "max_attempts": 1,
    "timeout": 5.0,
    "time_dilation_factor": 0.5,
    "voxel_size": 0.05,
    "collision_activation_distance": 0.025,
    "convergence_threshold": 0.01,
    "max_mpc_iterations": 1000,
    "mpc_horizon": 30,
    "mpc_control_frequency": 50.0,
    "obb_cache_size": 100,
    "mesh_cache_size": 100,
    "blox_cache_size": 10,
    "preempt": False,
    "convergence_threshold_rad": 0.05,
    "convergence_hold_steps": 1,
    "mpc_step_dt": 0.03,
    "mpc_horizon_steps": 30,
    "node_is_available": True,
}


@dataclass
class Node:
    """The parameters of /unified_planner, through its services."""

    client: AsyncParameterClient

    def get(self, name: str) -> Any:
        response = answer(self.client.get_parameters([name]), "the parameter is told")
        return parameter_value_to_python(response.values[0])

    def set(self, name: str, value: Any) -> str | None:
        """None, or the reason against it."""
        response = answer(self.client.set_parameters([Parameter(name, value=value)]), "the parameter is set or refused")
        return None if response.results[0].successful else response.results[0].reason

    def becomes(self, name: str, value: Any) -> None:
        eventually(lambda: self.get(name) == value, f"{name} is {value}")


@pytest.fixture(scope="module")
def parameters(running: Stack) -> Node:
    client = AsyncParameterClient(running.ros.node, "/unified_planner")
    assert client.wait_for_services(PATIENCE)
    node = Node(client)
    node.becomes("node_is_available", True)
    return node


def switch(running: Stack, strategy: str) -> None:
    """As any client on the bus does, which tries again where another one switches at that moment."""

    def switched() -> Strategies | None:
        with suppress(Busy):
            return running.bus.call(KEYS.strategy, StrategyRequest(strategy=strategy), timeout=20)
        return None

    eventually(switched, f"{strategy} is active")


def test_every_parameter_has_the_default_that_is_documented(parameters: Node) -> None:
    assert {name: parameters.get(name) for name in DEFAULTS} == DEFAULTS


def test_every_parameter_is_described(parameters: Node) -> None:
    names = list(DEFAULTS)
    described = answer(parameters.client.describe_parameters(names), "they are described").descriptors
    assert [one.name for one in described] == names
    assert all(one.description for one in described)
    for one in described:
        if isinstance(DEFAULTS[one.name], float):
            assert one.type == ParameterType.PARAMETER_DOUBLE
            assert one.floating_point_range
        elif not isinstance(DEFAULTS[one.name], str | bool):
            assert one.type == ParameterType.PARAMETER_INTEGER
            assert one.integer_range


@pytest.mark.parametrize("name", ["robot", "robot_config_file", "base_link"])
def test_what_the_robot_is_cannot_be_changed(parameters: Node, name: str) -> None:
    reason = parameters.set(name, "other")
    assert reason is not None
    assert "read-only" in reason
    assert parameters.get(name) == DEFAULTS[name]


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("timeout", 0.0),
        ("timeout", -1.0),
        ("timeout", 1e9),
        ("timeout", math.nan),
        ("timeout", math.inf),
        ("timeout", "soon"),
        ("max_attempts", 0),
        ("max_attempts", 2.5),
        ("time_dilation_factor", 0.0),
        ("voxel_size", 0.0),
        ("collision_activation_distance", -0.01),
        ("convergence_threshold", 0.0),
        ("max_mpc_iterations", 0),
        ("mpc_horizon", 0),
        ("mpc_control_frequency", 0.0),
        ("obb_cache_size", -2),
        ("mesh_cache_size", -2),
        ("blox_cache_size", -2),
        ("planner_type", "fastest"),
        ("node_is_available", False),
        ("robot_type", ""),
        ("robot_type", "ur5e"),
        ("control_strategy", ""),
        ("control_strategy", "é"),
        ("control_strategy", "fastest"),
        ("control_strategy", "joint_speed"),  # without a driver
        ("world_file", "/no/such/file.yaml"),
    ],
)
def test_a_value_that_cannot_be_is_refused_with_the_reason(parameters: Node, name: str, value: Any) -> None:
    reason = parameters.set(name, value)
    assert reason
    assert parameters.get(name) == DEFAULTS[name]


@pytest.mark.parametrize(("name", "value"), [("timeout", 2.5), ("max_attempts", 7), ("planner_type", "joint_space")])
def test_a_value_that_can_be_is_taken(parameters: Node, name: str, value: Any) -> None:
    assert parameters.set(name, value) is None
    assert parameters.get(name) == value
    assert parameters.set(name, DEFAULTS[name]) is None


def test_control_strategy_switches_at_once(running: Stack, parameters: Node) -> None:
    for strategy in ("ghost", "emulator"):
        assert parameters.set("control_strategy", strategy) is None
        assert running.bus.call(KEYS.strategy, StrategyRequest(), timeout=10).active == strategy
        assert parameters.get("control_strategy") == strategy
        parameters.becomes("robot_type", strategy)


def test_a_failed_switch_is_refused_with_the_executor_s_reason(running: Stack, parameters: Node) -> None:
    reason = parameters.set("control_strategy", "joint_speed")
    assert reason is not None
    assert "no driver publishes the robot's joints" in reason
    assert (parameters.get("control_strategy"), parameters.get("robot_type")) == ("emulator", "emulator")


def test_the_parameters_follow_whoever_switches(running: Stack, parameters: Node) -> None:
    for strategy in ("ghost", "emulator"):
        switch(running, strategy)
        parameters.becomes("control_strategy", strategy)
        parameters.becomes("robot_type", strategy)
    kind = SetRobotStrategy
    assert running.ros.call(kind, "set_robot_strategy", robot_strategy="ghost").success
    assert parameters.get("control_strategy") == "ghost"
    assert running.ros.call(kind, "set_robot_strategy", robot_strategy="emulator").success
    assert parameters.get("control_strategy") == "emulator"


@pytest.mark.slow
def test_after_concurrent_switches_parameters_are_consistent(running: Stack, parameters: Node) -> None:
    for _ in range(10):
        pending = parameters.client.set_parameters([Parameter("control_strategy", value="ghost")])
        switch(running, "emulator")
        switch(running, "ghost")
        switch(running, "emulator")
        answer(pending, "the parameter is set")
    active = running.bus.call(KEYS.strategy, StrategyRequest(), timeout=10).active
    parameters.becomes("control_strategy", active)
    parameters.becomes("robot_type", active)
    switch(running, "emulator")
    parameters.becomes("control_strategy", "emulator")


CUROBO_WORLD = """
cuboid:
  table:
    dims: [1.0, 2, 0.1]
    pose: [0.5, 0.0, -0.3, 1, 0, 0, 0.0]
sphere:
  ball:
    radius: 0.1
    position: [1, 2, 3]
cylinder:
  post:
    radius: 0.05
    height: 0.5
    pose: [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0]
"""


def test_a_world_file_of_curobo_becomes_the_scene(running: Stack, parameters: Node, tmp_path: Path) -> None:
    file = tmp_path / "world.yml"
    file.write_text(CUROBO_WORLD)
    assert parameters.set("world_file", str(file)) is None
    scene = running.bus.read(KEYS.scene, timeout=10)
    assert scene.objects == (
        Cuboid(kind="cuboid", name="table", position=(0.5, 0.0, -0.3), size=(1.0, 2.0, 0.1)),
        Sphere(kind="sphere", name="ball", position=(1.0, 2.0, 3.0), radius=0.1),
        Cylinder(
            kind="cylinder",
            name="post",
            position=(1.0, 0.0, 0.0),
            orientation=(1.0, 0.0, 0.0, 0.0),
            radius=0.05,
            length=0.5,
        ),
    )
    assert parameters.set("world_file", "") is None


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("- 1", "is a mapping of keys to values"),
        ("a: [", "not valid YAML"),
        ("blox: {}", "not a kind of obstacle"),
        ("cuboid: {table: {dims: [1, 1, 1]}}", "the cuboid table"),
        ("cuboid: {table: {dims: [1, 1, -1], pose: [0, 0, 0, 1, 0, 0, 0]}}", "objects.0.size.2"),
        ("objects: [{kind: sphere, name: ball, position: [0, 0, 9], radius: .nan}]", "world.yml"),
        ("objects: 3", "world.yml"),
        ("cuboid: 3", "world.yml"),
        ("cuboid: {a: {dims: [1, 1, 1], pose: [0, 0, 0, 1, 0, 0, 0], inflate: 0.1}}", "inflate is not read here"),
        (
            "sphere:\n  a: {radius: 1, pose: [0, 0, 9]}\nsphere:\n  b: {radius: 1, pose: [0, 0, 9]}",
            "also appears in line 1",
        ),
    ],
)
def test_an_unreadable_world_file_is_refused_and_the_scene_stays(
    running: Stack, parameters: Node, tmp_path: Path, text: str, reason: str
) -> None:
    file = tmp_path / "world.yml"
    file.write_text(text)
    before = running.bus.read(KEYS.scene, timeout=10)
    refusal = parameters.set("world_file", str(file))
    assert refusal is not None
    assert reason in refusal
    assert parameters.get("world_file") == ""
    assert running.bus.read(KEYS.scene, timeout=10) == before


def test_a_scene_of_zarm_is_loaded_as_it_is(running: Stack, parameters: Node, tmp_path: Path) -> None:
    file = tmp_path / "world.yml"
    file.write_text("objects: [{kind: sphere, name: ball, position: [0, 0, 9], radius: 0.1}]")
    assert parameters.set("world_file", str(file)) is None
    assert parameters.get("world_file") == str(file)
    scene = running.bus.read(KEYS.scene, timeout=10)
    assert scene.objects == (Sphere(kind="sphere", name="ball", position=(0.0, 0.0, 9.0), radius=0.1),)
    assert parameters.set("world_file", "") is None
