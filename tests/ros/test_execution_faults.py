"""Goals whose planner, executor, bridge or client is missing or dies: every client gets an answer, and nothing hangs."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack, closing
from dataclasses import dataclass, field
from pathlib import Path

import pytest
from action_msgs.srv import CancelGoal
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.parameter_client import AsyncParameterClient
from std_srvs.srv import Trigger

from support.harness import PATIENCE, ServiceProcess, eventually, free_endpoint, router
from support.ros.goals import ABORTED, SUCCEEDED, TARGET, Actions, Robot, Sent
from support.ros.node import answer, running_node
from support.ros.stack import KEYS, RosClient
from zarm_contract.messages import GoalState, StrategyRequest
from zarm_ros_bridge.goals import SILENCE
from zarm_runtime.bus import Bus
from zarm_runtime.session import open_router

CLIENT = """
import sys
import rclpy
from curobo_msgs.action import SendTrajectory
from rclpy.action import ActionClient

rclpy.init()
node = rclpy.create_node("short_lived")
client = ActionClient(node, SendTrajectory, "/unified_planner/execute_trajectory")
client.wait_for_server()
sent = client.send_goal_async(SendTrajectory.Goal(), feedback_callback=lambda told: print(told.feedback.state, flush=True))
rclpy.spin_until_future_complete(node, sent)
rclpy.spin(node)
"""


@dataclass
class Zarm:
    """Processes of one robot, each started when a test asks for it; the planner is there from the start."""

    bus: Bus
    node: Node
    folder: Path
    endpoint: str
    _stack: ExitStack = field(default_factory=ExitStack)

    def start(self, *services: str) -> list[ServiceProcess]:
        """Start these services and wait until they are ready; they end with the test."""
        processes = [ServiceProcess(service, self.endpoint, self.folder, name=KEYS.robot) for service in services]
        for process in processes:
            self._stack.enter_context(process)
        for process in processes:
            process.wait_ready(self.bus, KEYS)
        return processes

    def close(self) -> None:
        """End what was started."""
        self._stack.close()

    @property
    def robot(self) -> Robot:
        return Robot(self.bus, KEYS)

    def goal_under_way(self, speed: float = 0.15) -> Sent:
        """A goal in the middle of its motion, at this share of the speed."""
        self.robot.plan(speed=speed)
        goal = Actions(self.node).send()
        goal.under_way()
        return goal

    def executor_goal(self) -> str:
        """The goal of the executor that runs."""
        return eventually(lambda: self.robot.state().goal_id, "a goal runs")

    def outcome(self, goal_id: str) -> GoalState:
        """The end of a goal of the executor's."""

        def last() -> GoalState | None:
            state = self.bus.read(KEYS.goal(goal_id), timeout=10)
            return state if state.done else None

        return eventually(last, f"{goal_id} ends")


@pytest.fixture(scope="module")
def planned(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Zarm]:
    folder = tmp_path_factory.mktemp("faults")
    with router() as endpoint, Bus(endpoint) as bus, running_node("client") as node:
        zarm = Zarm(bus, node, folder, endpoint)
        with closing(zarm):
            zarm.start("planner")
            yield zarm


@pytest.fixture
def zarm(planned: Zarm, node: Node) -> Iterator[Zarm]:
    """With a node of the test's own: one that knew a bridge that was killed goes on asking it for 5 s."""
    with closing(Zarm(planned.bus, node, planned.folder, planned.endpoint)) as one:
        yield one


@pytest.mark.slow  # as without an executor
def test_without_a_planner_a_target_is_refused_by_name(tmp_path: Path) -> None:
    with router() as endpoint, Bus(endpoint) as bus, running_node("client") as node:
        zarm = Zarm(bus, node, tmp_path, endpoint)
        with closing(zarm):
            zarm.start("executor", "ros_bridge")
            goal = Actions(node).send()
            status, result = goal.ended()
            assert (status, result.message) == (
                ABORTED,
                "there is no plan to execute yet; plan first (/unified_planner/generate_trajectory), or send a trajectory",
            )
            goal = Actions(node).send(target_pose=TARGET)
            status, result = goal.ended()
            assert (status, result.success) == (ABORTED, False)
            assert "the planner of arm has not answered; " in result.message


def test_without_an_executor_a_goal_is_refused_by_name(zarm: Zarm) -> None:
    zarm.start("ros_bridge")
    status, result = Actions(zarm.node).send().ended()
    assert (status, result.success) == (ABORTED, False)
    assert "the executor of arm has not answered" in result.message


def test_a_goal_whose_executor_is_killed_is_aborted(zarm: Zarm) -> None:
    executor, _ = zarm.start("executor", "ros_bridge")
    goal = zarm.goal_under_way()
    executor.kill()
    status, result = goal.ended()
    assert status == ABORTED
    assert f"for {SILENCE:g} s" in result.message


@pytest.mark.slow
def test_a_restarted_executor_aborts_its_goal(zarm: Zarm) -> None:
    executor, _ = zarm.start("executor", "ros_bridge")
    goal = zarm.goal_under_way()
    executor_goal = zarm.executor_goal()
    executor.kill()
    zarm.start("executor")
    problem = zarm.outcome(executor_goal).problem
    assert problem is not None
    status, result = goal.ended()
    assert status == ABORTED
    assert result.message == problem.message or f"for {SILENCE:g} s" in result.message
    zarm.robot.plan()
    assert Actions(zarm.node).send().ended()[0] == SUCCEEDED


@pytest.mark.slow
def test_a_frozen_executor_s_goal_is_aborted_and_withdrawn(zarm: Zarm) -> None:
    executor, _ = zarm.start("executor", "ros_bridge")
    zarm.robot.plan()
    before = zarm.robot.joints()
    os.kill(executor.process.pid, signal.SIGSTOP)
    status, result = Actions(zarm.node).send().ended()
    os.kill(executor.process.pid, signal.SIGCONT)
    assert status == ABORTED
    assert "the executor of arm has not answered" in result.message
    zarm.robot.wait_rest()
    assert max(abs(a - b) for a, b in zip(zarm.robot.joints(), before, strict=True)) < 0.05


@pytest.mark.slow
def test_a_bridge_on_sigterm_aborts_its_goal_alone(zarm: Zarm) -> None:
    _, bridge = zarm.start("executor", "ros_bridge")
    goal = zarm.goal_under_way()
    executor_goal = zarm.executor_goal()
    bridge.process.terminate()
    status, result = goal.ended()
    assert status == ABORTED
    assert f"{executor_goal} of {KEYS.robot} goes on" in result.message
    assert bridge.process.wait(PATIENCE) == 0, bridge.output()
    assert "Traceback" not in bridge.output()
    assert zarm.outcome(executor_goal).status == "succeeded"


@pytest.mark.slow
def test_a_killed_bridge_s_goal_is_taken_up_by_the_next(zarm: Zarm) -> None:
    _, bridge = zarm.start("executor", "ros_bridge")
    goal = zarm.goal_under_way(speed=0.03)
    executor_goal = zarm.executor_goal()
    bridge.kill()
    goal.feedback.clear()
    zarm.start("ros_bridge")
    eventually(lambda: goal.feedback, "the client hears of its goal again")
    assert zarm.outcome(executor_goal).status == "succeeded"
    status, result = goal.asked_again()
    assert (status, result.success) == (SUCCEEDED, True)
    zarm.robot.plan()
    with running_node("later") as node:  # DDS tells those that knew the dead one of its end 5 s later
        assert Actions(node).send().ended()[0] == SUCCEEDED


@pytest.mark.slow
def test_a_killed_client_s_goal_goes_on_and_can_be_cancelled(zarm: Zarm) -> None:
    zarm.start("executor", "ros_bridge")
    zarm.robot.plan(speed=0.15)
    with subprocess.Popen([sys.executable, "-c", CLIENT], stdout=subprocess.PIPE, text=True) as client:
        assert client.stdout is not None
        assert any(line.strip() == "EXECUTING" for line in client.stdout)
        client.kill()
    executor_goal = zarm.executor_goal()
    cancel = zarm.node.create_client(CancelGoal, "/unified_planner/execute_trajectory/_action/cancel_goal")
    assert cancel.wait_for_service(PATIENCE)
    response = answer(cancel.call_async(CancelGoal.Request()), "the cancel is answered")  # of every goal
    assert len(response.goals_canceling) == 1
    assert zarm.outcome(executor_goal).status == "cancelled"
    zarm.robot.plan()
    assert Actions(zarm.node).send().ended()[0] == SUCCEEDED


@pytest.mark.slow
def test_a_second_bridge_for_a_robot_refuses_to_start(zarm: Zarm) -> None:
    _, first = zarm.start("executor", "ros_bridge")
    with ServiceProcess("ros_bridge", zarm.endpoint, zarm.folder, name=KEYS.robot) as second:
        assert second.process.wait(PATIENCE) == 1
        assert "already on this bus" in second.output()
    assert first.process.poll() is None
    zarm.robot.plan()
    assert Actions(zarm.node).send().ended()[0] == SUCCEEDED


@pytest.mark.slow  # near to the goal without an executor
def test_without_an_executor_version_1_keeps_robot_type(zarm: Zarm) -> None:
    zarm.start("ros_bridge")
    parameters = AsyncParameterClient(zarm.node, "/unified_planner")
    assert parameters.wait_for_services(PATIENCE)
    change = parameters.set_parameters([Parameter("robot_type", value="ghost")])
    assert answer(change, "the parameter is set").results[0].successful
    answered = RosClient(zarm.node).call(Trigger, "set_robot_strategy")
    assert not answered.success
    assert "the executor of arm has not answered; " in answered.message
    value = answer(parameters.get_parameters(["robot_type"]), "the parameter is told").values[0]
    assert value.string_value == "emulator"


@pytest.mark.slow
def test_parameters_follow_an_executor_with_another_strategy(zarm: Zarm) -> None:
    _, executor = zarm.start("ros_bridge", "executor")
    parameters = AsyncParameterClient(zarm.node, "/unified_planner")
    assert parameters.wait_for_services(PATIENCE)

    def strategy() -> str:
        report = answer(parameters.get_parameters(["control_strategy"]), "the parameter is told")
        return str(report.values[0].string_value)

    zarm.bus.call(KEYS.strategy, StrategyRequest(strategy="ghost"), timeout=10)
    eventually(lambda: strategy() == "ghost", "the parameter follows")
    executor.kill()
    zarm.start("executor")
    eventually(lambda: strategy() == "emulator", "the parameter follows")


@pytest.mark.slow
def test_a_router_restart_in_motion_does_not_end_the_goal(tmp_path: Path) -> None:
    endpoint = free_endpoint()
    with ExitStack() as first, ExitStack() as stack:
        first.enter_context(open_router(endpoint))
        bus = stack.enter_context(Bus(endpoint))
        node = stack.enter_context(running_node("client"))
        zarm = stack.enter_context(closing(Zarm(bus, node, tmp_path, endpoint)))
        zarm.start("planner", "executor", "ros_bridge")
        goal = zarm.goal_under_way()
        first.close()
        stack.enter_context(open_router(endpoint))
        status, result = goal.ended()
        assert (status, result.message) == (SUCCEEDED, "Trajectory executed successfully")
        zarm.robot.plan()
        assert Actions(node).send().ended()[0] == SUCCEEDED
