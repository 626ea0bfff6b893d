"""A digital output that a ROS service switches."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest
from rclpy.node import Node
from std_srvs.srv import SetBool

import zarm
from support.harness import ServiceProcess, eventually, router
from support.outputs import M1013, with_outputs
from support.ros.node import destroyed
from zarm_contract.keys import Keys
from zarm_runtime.bus import Bus

KEYS = Keys(M1013.descriptor.name)
AWAY = (0.1, *M1013.descriptor.home[1:])


@contextmanager
def vacuum(node: Node, asked: list[bool], *, works: bool) -> Iterator[None]:
    """The robot's service for its vacuum."""

    def switch(request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        asked.append(request.data)
        response.success, response.message = works, "" if works else "no air"
        return response

    service = node.create_service(SetBool, "/cell/vacuum", switch)
    try:
        yield
    finally:
        destroyed(node, node.destroy_service, service)


def test_output_is_switched_through_the_service_of_the_robot(node: Node, tmp_path: Path) -> None:
    descriptor = with_outputs(tmp_path, "{service: /cell/vacuum, driver_timeout: 20}")
    asked: list[bool] = []
    with ExitStack() as stack:
        endpoint = stack.enter_context(router())
        bus = stack.enter_context(Bus(endpoint))
        for service, arguments in (
            ("ros_bridge", ()),
            ("leeloo_sim", ("--ros",)),
            ("executor", ("--strategy", "joint_pose")),
        ):
            process = ServiceProcess(service, endpoint, tmp_path, descriptor, arguments=arguments)
            stack.enter_context(process).wait_ready(bus, KEYS)
        robot = stack.enter_context(zarm.connect(endpoint))
        with pytest.raises(zarm.ExecutionFailed, match="nobody serves /cell/vacuum"):
            robot.outputs.set("vacuum", True)
        with vacuum(node, asked, works=True):
            assert robot.outputs.set("vacuum", True).on is True
            assert robot.outputs.set("vacuum", False).on is False
        with (
            vacuum(node, asked, works=False),
            pytest.raises(zarm.ExecutionFailed, match="/cell/vacuum refused: no air"),
        ):
            robot.outputs.set("vacuum", True)
        assert robot.outputs.all()["vacuum"].on is False
        assert asked == [True, False, True]


@contextmanager
def cell_with_frozen_service(node: Node, folder: Path, *more: str) -> Iterator[tuple[zarm.Robot, ServiceProcess, Node]]:
    """A robot whose vacuum is served by a node that nobody spins; and its bridge."""
    descriptor = with_outputs(folder, "{service: /cell/vacuum, driver_timeout: 30}")
    with ExitStack() as stack:
        endpoint = stack.enter_context(router())
        bus = stack.enter_context(Bus(endpoint))
        bridge = ServiceProcess("ros_bridge", endpoint, folder, descriptor)
        for process in (
            bridge,
            ServiceProcess("leeloo_sim", endpoint, folder, descriptor, arguments=("--ros",)),
            ServiceProcess("executor", endpoint, folder, descriptor, arguments=("--strategy", "joint_pose")),
            *(ServiceProcess(name, endpoint, folder, descriptor) for name in more),
        ):
            stack.enter_context(process).wait_ready(bus, KEYS)
        robot = stack.enter_context(zarm.connect(endpoint))
        frozen = Node("frozen", context=node.context)
        frozen.create_service(SetBool, "/cell/vacuum", lambda request, response: response)
        yield robot, bridge, frozen


def called_again(bridge: ServiceProcess) -> None:
    eventually(lambda: "the service is called again" in bridge.output() or None, "the bridge calls again")


def test_a_service_that_was_replaced_is_called_again(node: Node, tmp_path: Path) -> None:
    asked: list[bool] = []
    with (
        cell_with_frozen_service(node, tmp_path) as (robot, bridge, frozen),
        ThreadPoolExecutor(1) as pool,
    ):
        switching = pool.submit(robot.outputs.set, "vacuum", True)
        called_again(bridge)
        frozen.destroy_node()
        with vacuum(node, asked, works=True):
            assert switching.result(60).on is True
        assert set(asked) == {True}


def test_what_was_cancelled_is_not_switched_later(node: Node, tmp_path: Path) -> None:
    asked: list[bool] = []
    with cell_with_frozen_service(node, tmp_path, "planner") as (robot, bridge, frozen):
        goal_id = robot.start(robot.plan_program([zarm.Move(AWAY), zarm.SetOutput("vacuum", True)]))
        called_again(bridge)
        robot.cancel(goal_id)
        eventually(lambda: robot.outputs.all()["vacuum"].problem, "the executor has given it up")
        frozen.destroy_node()
        with vacuum(node, asked, works=True), pytest.raises(AssertionError, match="in vain"):
            eventually(lambda: asked or None, "the vacuum is switched on", patience=3.0)
