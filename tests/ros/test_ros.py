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
from zarm_ros_bridge.ros import Ros

ALONE = ("unshare", "--net")
"""In a network of its own, for what would be heard by all the machine's."""
MEMORY = """
from zarm_ros_bridge.ros import Ros

with Ros("alone", workers=1) as ros, open("/proc/self/maps") as maps:
    print("fastrtps_port" in maps.read())
"""


def test_a_callback_that_raises_is_logged_and_the_next_request_is_answered(
    node: Node, caplog: pytest.LogCaptureFixture
) -> None:
    heard: list[bool] = []

    def hear(message: Bool) -> None:
        heard.append(message.data)
        raise ValueError("a listener fails")

    def fail(_: Trigger.Request, __: Trigger.Response) -> Trigger.Response:
        raise ValueError("a service fails")

    with Ros("fragile", workers=2) as ros:
        ros.serve(Trigger, "~/fail", fail)
        ros.serve(Trigger, "~/work", lambda _, response: response)
        ros.listen(Bool, "told", hear, 10)
        ros.spin()
        failing, working = (node.create_client(Trigger, f"/fragile/{name}") for name in ("fail", "work"))
        assert failing.wait_for_service(PATIENCE)
        assert working.wait_for_service(PATIENCE)
        failing.call_async(Trigger.Request())
        eventually(lambda: "a service fails" in caplog.text, "the failure is logged")
        answer(working.call_async(Trigger.Request()), "the next request is answered")
        told = node.create_publisher(Bool, "told", 10)
        eventually(told.get_subscription_count, "the node listens")
        for count in (1, 2):
            told.publish(Bool(data=True))
            eventually(lambda at=count: len(heard) == at, "the message is heard")
        eventually(lambda: caplog.text.count("ValueError: a listener fails") == 2, "both failures are logged")


@pytest.mark.skipif(
    subprocess.run([*ALONE, "true"], capture_output=True).returncode != 0,
    reason="needs the right to a network namespace",
)
@pytest.mark.parametrize(("said", "shared"), [({}, "False"), ({"FASTDDS_BUILTIN_TRANSPORTS": "DEFAULT"}, "True")])
def test_it_shares_no_memory_that_a_killed_process_could_hold_up_unless_that_is_asked_for(
    said: dict[str, str], shared: str
) -> None:
    usual = {name: value for name, value in os.environ.items() if not name.startswith(("FASTRTPS_", "FASTDDS_"))}
    environment = {**usual, "ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET", **said}
    command = [*ALONE, sys.executable, "-c", MEMORY]
    told = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=PATIENCE)
    assert told.stdout.strip() == shared, told.stderr
