"""The cost of ROS itself: a plain rclpy server of MoveIt's action that only returns a trajectory prepared before.

python ros_ready_made_action.py ACTION POINTS JOINT ...
"""

from __future__ import annotations

import sys
from contextlib import suppress
from typing import Any

import rclpy
from moveit_msgs.action import MoveGroup
from rclpy.action import ActionServer
from rclpy.executors import ExternalShutdownException
from trajectory_msgs.msg import JointTrajectoryPoint


def main(action: str, points: str, *joints: str) -> None:
    values = [float(index) for index in range(len(joints))]
    ready = MoveGroup.Result()
    ready.error_code.val = 1
    ready.planned_trajectory.joint_trajectory.joint_names = list(joints)
    ready.planned_trajectory.joint_trajectory.points = [
        JointTrajectoryPoint(positions=values, velocities=values, accelerations=values) for _ in range(int(points))
    ]

    def carry_out(handle: Any) -> Any:
        handle.succeed()
        return ready

    rclpy.init(args=[])
    node = rclpy.create_node("ready_made")
    server = ActionServer(node, MoveGroup, action, carry_out)
    with suppress(ExternalShutdownException):
        rclpy.spin(node)
    server.destroy()


if __name__ == "__main__":
    main(*sys.argv[1:])
