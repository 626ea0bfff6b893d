"""Many clients on ROS: processes of one participant with several nodes each, which ask the bridge everything at once.

DDS that is kept to one machine looks for 32 participants there, so that 50 clients cannot have one each.

`python ros_crowd.py NODES` is one of these processes: it says `ready` when every node sees every service; after an empty line
every node asks all of them, and one line of JSON `[service, success, message]` is written for each answer, an empty one at the
end.
"""

from __future__ import annotations

import json
import subprocess
import sys
import time
from typing import Any, NamedTuple, Self

import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.task import Future
from sensor_msgs.msg import JointState

from curobo_msgs.srv import Fk, GetRobotStrategies, TrajectoryGeneration

PATIENCE = 60.0
"""Seconds after which a request counts as not answered; no promise about speed."""
HOME = [0.0, 0.0, 1.5, 0.0, 1.5, 0.0]
"""Joints of the M1013 that are free of collision."""


REPLIES = QoSProfile(depth=1000)
"""Every client of a service is sent the replies to all: of the default, 10, what comes on top between two looks is lost."""


class Answer(NamedTuple):
    """What a client was told; `message` is empty where all is well."""

    service: str
    success: bool
    message: str


class Crowd:
    """`processes` of `nodes` clients each, which see the bridge, in `with`."""

    def __init__(self, processes: int, nodes: int) -> None:
        self._command = [sys.executable, __file__, str(nodes)]
        self._count = processes

    def __enter__(self) -> Self:
        self._processes = [
            subprocess.Popen(self._command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
            for _ in range(self._count)
        ]
        for process in self._processes:
            assert process.stdout is not None
            assert process.stdout.readline() == "ready\n"
        return self

    def __exit__(self, *_: object) -> None:
        """End them: half of them as programs end, half as they crash."""
        for place, process in enumerate(self._processes):
            if place % 2:
                process.kill()
            process.communicate()

    def ask(self) -> list[Answer]:
        """Let every client ask everything at once; every answer."""
        for process in self._processes:
            assert process.stdin is not None
            process.stdin.write("\n")
            process.stdin.flush()
        return [
            Answer(*json.loads(line)) for process in self._processes for line in iter(process.stdout.readline, "\n")
        ]


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


def _told(name: str, response: Any) -> Answer:
    if name == "fk":
        return Answer(name, not response.error_msg.data, response.error_msg.data)
    return Answer(name, response.success, "" if response.success else getattr(response, "message", ""))


def _asked(executor: SingleThreadedExecutor, asked: list[tuple[str, Any, Any]]) -> list[Future]:
    """Ask all of this at once, and wait for the answers."""
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
    for _ in iter(sys.stdin.readline, ""):
        for (name, _, _), future in zip(asked, _asked(executor, asked), strict=True):
            told = _told(name, future.result()) if future.done() else Answer(name, False, "NO ANSWER")
            sys.stdout.write(json.dumps(told) + "\n")
        sys.stdout.write("\n")
        sys.stdout.flush()
    executor.shutdown()
    context.shutdown()


if __name__ == "__main__":
    _clients(int(sys.argv[1]))
