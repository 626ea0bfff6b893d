"""The cost of ROS itself: a plain rclpy server that only returns a trajectory prepared before.

python ros_ready_made.py SERVICE POINTS JOINT ...
"""

from __future__ import annotations

import sys
from contextlib import suppress

import rclpy
from rclpy.executors import ExternalShutdownException
from sensor_msgs.msg import JointState

from curobo_msgs.srv import TrajectoryGeneration


def main(service: str, points: str, *joints: str) -> None:
    values = [float(index) for index in range(len(joints))]
    ready = TrajectoryGeneration.Response(
        success=True,
        trajectory=[
            JointState(name=list(joints), position=values, velocity=values, effort=[]) for _ in range(int(points))
        ],
    )
    rclpy.init(args=[])
    node = rclpy.create_node("ready_made")
    node.create_service(TrajectoryGeneration, service, lambda _request, _response: ready)
    with suppress(ExternalShutdownException):
        rclpy.spin(node)


if __name__ == "__main__":
    main(*sys.argv[1:])
