"""A participant of the bridge outlives what goes wrong in its callbacks."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest
from rclpy.node import Node
from std_msgs.msg import Bool
from std_srvs.srv import Trigger

from support.harness import PATIENCE, eventually
from support.ros.node import answer
from support.tiers import sampled
from zarm_ros_bridge.ros import Ros

ALONE = ("unshare", "--net", "sh", "-c", 'ip link set lo up && exec "$@"', "sh")
"""In a network of its own, for what would be heard by all the machine's."""
BRIDGE = """
from zarm_ros_bridge.ros import Ros

joined = Ros("alone", workers=1)
"""
DRIVER = """
from zarm_contract.robot import load_robot
from zarm_simulated_driver.axes import Axes
from zarm_simulated_driver.ros_side import ros_side

robot = load_robot("doosan_m1013").descriptor
joined = ros_side("alone", robot.strategy_params, Axes.of(robot))
"""
REACH = """
with joined, open("/proc/self/maps") as maps, open("/proc/net/udp") as sockets:
    listens = {line.split()[1].partition(":")[0] for line in sockets if ":" in line}
    print("shared memory" if "fastrtps_port" in maps.read() else "no shared memory", end=", ")
    print("every interface" if "00000000" in listens else "the loopback" if "0100007F" in listens else "nothing")
"""


def test_a_failing_callback_is_logged_and_the_next_is_served(node: Node, caplog: pytest.LogCaptureFixture) -> None:
    heard: list[bool] = []

    def receive(message: Bool) -> None:
        heard.append(message.data)
        raise ValueError("a listener fails")

    def fail(_: Trigger.Request, __: Trigger.Response) -> Trigger.Response:
        raise ValueError("a service fails")

    with Ros("fragile", workers=2) as ros:
        ros.serve(Trigger, "~/fail", fail)
        ros.serve(Trigger, "~/work", lambda _, response: response)
        ros.listen(Bool, "told", receive, 10)
        ros.spin()
        failing, working = (node.create_client(Trigger, f"/fragile/{name}") for name in ("fail", "work"))
        assert failing.wait_for_service(PATIENCE)
        assert working.wait_for_service(PATIENCE)
        failing.call_async(Trigger.Request())
        eventually(lambda: "a service fails" in caplog.text, "the failure is logged")
        answer(working.call_async(Trigger.Request()), "the next request is answered")
        report = node.create_publisher(Bool, "told", 10)
        eventually(report.get_subscription_count, "the node listens")
        for count in (1, 2):
            report.publish(Bool(data=True))
            eventually(lambda at=count: len(heard) == at, "the message is heard")
        eventually(lambda: caplog.text.count("ValueError: a listener fails") == 2, "both failures are logged")


@pytest.mark.skipif(
    subprocess.run([*ALONE, "true"], capture_output=True).returncode != 0,
    reason="needs the right to a network namespace",
)
@pytest.mark.parametrize("who", sampled(BRIDGE, DRIVER), ids=["bridge", "simulated driver"])
@pytest.mark.parametrize(
    ("said", "reach"),
    [
        ({}, "no shared memory, every interface"),
        ({"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}, "no shared memory, the loopback"),
        ({"ROS_LOCALHOST_ONLY": "1"}, "no shared memory, the loopback"),
        ({"FASTDDS_BUILTIN_TRANSPORTS": "DEFAULT"}, "shared memory, every interface"),
    ],
    ids=["unsaid", "this machine", "this machine, as before Jazzy", "with shared memory"],
)
def test_discovery_is_as_set_or_warns_without_shared_memory(who: str, said: dict[str, str], reach: str) -> None:
    usual = {
        name: value for name, value in os.environ.items() if not name.startswith(("FASTRTPS_", "FASTDDS_", "ROS_"))
    }
    command = [*ALONE, sys.executable, "-c", who + REACH]
    report = subprocess.run(command, env={**usual, **said}, capture_output=True, text=True, timeout=PATIENCE)
    assert report.stdout.strip() == reach, report.stderr
    assert ("whoever reaches it can move the robot" in report.stderr) == (reach.endswith("every interface"))


SERVER = """
import sys
from std_srvs.srv import Trigger
from zarm_ros_bridge.ros import Ros

with Ros("short_lived", workers=1) as ros:
    ros.serve(Trigger, "~/work", lambda _, response: response)
    ros.spin()
    sys.stdin.read()
"""


@pytest.mark.slow
def test_a_killed_bridge_is_gone_for_clients_after_5_s(node: Node) -> None:
    client = node.create_client(Trigger, "/short_lived/work")
    server = subprocess.Popen([sys.executable, "-c", SERVER], stdin=subprocess.PIPE)
    try:
        assert client.wait_for_service(PATIENCE)
    finally:
        server.kill()
        server.communicate()
    eventually(lambda: not client.service_is_ready(), "the client knows", patience=12.0)


def test_tools_find_the_node_that_serves_parameters(node: Node) -> None:
    with Ros("seen", workers=1, parameters=True) as ros:
        ros.spin()
        eventually(lambda: "seen" in node.get_node_names(), "the node is found")
        others = {name for name in node.get_node_names() if "seen" in name} - {"seen"}
        assert all(name.startswith("_") for name in others)  # which `ros2 node list` and `ros2 param list` leave out
