"""Clients of a crowd on ROS, as nodes of one participant: `python crowd_client.py NODES`.

It says `ready` when every node sees every service. After each empty line every node calls all of them; it writes one
line of JSON `[service, success, message]` per answer, with an empty message if all is well, and an empty line at the
end.
"""

from __future__ import annotations

import json
import sys
import time
from typing import Any

import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.task import Future
from sensor_msgs.msg import JointState

from curobo_msgs.srv import Fk, GetRobotStrategies, TrajectoryGeneration

PATIENCE = 60.0
"""Seconds after which a request counts as unanswered; not a claim about speed."""
HOME = [0.0, 0.0, 1.5, 0.0, 1.5, 0.0]
"""Collision-free joints of the M1013."""
REPLIES = QoSProfile(depth=1000)
"""Every client of a service receives the replies to all clients: with the default depth of 10, replies are lost between
two reads.
"""


def _requests() -> list[tuple[str, type[Any], Any]]:
    start, goal = JointState(position=HOME), [HOME[0] + 0.5, *HOME[1:]]
    return [
        (
            "generate_trajectory",
            TrajectoryGeneration,
            TrajectoryGeneration.Request(start_pose=start, target_joint_positions=goal),
        ),
        ("get_robot_strategies", GetRobotStrategies, GetRobotStrategies.Request()),
        ("fk", Fk, Fk.Request(joint_states=[start])),
    ]


def _reported(name: str, response: Any) -> tuple[str, bool, str]:
    if name == "fk":
        return name, not response.error_msg.data, response.error_msg.data
    return name, response.success, "" if response.success else getattr(response, "message", "")


def _asked(executor: SingleThreadedExecutor, asked: list[tuple[str, Any, Any]]) -> list[Future]:
    """Send all of this at once, and wait for the answers."""
    futures = [client.call_async(request) for _, client, request in asked]
    deadline = time.monotonic() + PATIENCE
    while not all(future.done() for future in futures) and time.monotonic() < deadline:
        executor.spin_once(0.1)
    return futures


def _clients(count: int) -> None:
    context = Context()
    rclpy.init(args=[], context=context)
    executor = SingleThreadedExecutor(context=context)
    asked: list[tuple[str, Any, Any]] = []
    for number in range(count):
        node = Node(f"client_{number}", context=context, start_parameter_services=False, enable_rosout=False)
        executor.add_node(node)
        for name, kind, request in _requests():
            asked.append((name, node.create_client(kind, f"/unified_planner/{name}", qos_profile=REPLIES), request))
    for _, client, _ in asked:
        if not client.wait_for_service(PATIENCE):
            raise SystemExit("the bridge is not seen")
    sys.stdout.write("ready\n")
    sys.stdout.flush()
    for _ in sys.stdin:
        for (name, _, _), future in zip(asked, _asked(executor, asked), strict=True):
            reported = _reported(name, future.result()) if future.done() else (name, False, "NO ANSWER")
            sys.stdout.write(json.dumps(reported) + "\n")
        sys.stdout.write("\n")
        sys.stdout.flush()
    executor.shutdown()
    context.shutdown()


if __name__ == "__main__":
    _clients(int(sys.argv[1]))
