"""A stand-in for a robot under ros2_control: JointTrajectoryController and joint_state_broadcaster, as one ROS node.

    python ros_controller.py COMMAND_TOPIC JOINT_STATES_TOPIC JOINT=RAD ...

It takes trajectories as the controller does: by joint name, quintic between points that have velocities and accelerations,
a new trajectory replaces the old one from the moment it arrives, an empty one holds. The joints follow exactly. States
come at 100 Hz, joints in alphabetical order, as the broadcaster of UR's driver lists them.
"""

from __future__ import annotations

import sys
import time

import numpy as np
import rclpy
from rclpy.node import Node
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory

PERIOD = 0.01


class Controller(Node):
    def __init__(self, command_topic: str, states_topic: str, joints: dict[str, float]) -> None:
        super().__init__("controller")
        self.names = sorted(joints)
        self.position = np.array([joints[name] for name in self.names])
        self.velocity = np.zeros(len(self.names))
        self.times = np.zeros(0)
        self.rows = np.zeros((0, 3, len(self.names)))
        self.began = 0.0
        self.states = self.create_publisher(JointState, states_topic, 10)
        self.create_subscription(JointTrajectory, command_topic, self.take, 10)
        self.create_timer(PERIOD, self.tick)

    def take(self, message: JointTrajectory) -> None:
        self.began = time.monotonic()
        self.times = np.array([p.time_from_start.sec + p.time_from_start.nanosec * 1e-9 for p in message.points])
        if self.times.size == 0:
            self.velocity = np.zeros(len(self.names))
            return
        order = [list(message.joint_names).index(name) for name in self.names]
        self.rows = np.array(
            [[np.array(row)[order] for row in (p.positions, p.velocities, p.accelerations)] for p in message.points]
        )

    def tick(self) -> None:
        if self.times.size:
            self.position, self.velocity = self.at(time.monotonic() - self.began)
        state = JointState(name=self.names, position=self.position.tolist(), velocity=self.velocity.tolist())
        state.header.stamp = self.get_clock().now().to_msg()
        self.states.publish(state)

    def at(self, t: float) -> tuple[np.ndarray, np.ndarray]:
        """Position and velocity: the quintic that meets position, velocity and acceleration at both points."""
        if t >= self.times[-1]:
            return self.rows[-1, 0], np.zeros(len(self.names))
        index = int(np.searchsorted(self.times, t, side="right")) - 1
        span = self.times[index + 1] - self.times[index]
        (p0, v0, a0), (p1, v1, a1) = self.rows[index], self.rows[index + 1]
        ends = np.stack((p0, v0 * span, a0 * span**2, p1, v1 * span, a1 * span**2))
        powers = np.array([[j >= d and float(np.prod(range(j - d + 1, j + 1))) for j in range(6)] for d in range(3)])
        conditions = np.vstack((np.diag([1.0, 1.0, 2.0]) @ np.eye(3, 6), powers))
        coefficients = np.linalg.solve(conditions, ends)
        u = (t - self.times[index]) / span
        position = sum(c * u**j for j, c in enumerate(coefficients))
        velocity = sum(j * c * u ** (j - 1) for j, c in enumerate(coefficients) if j) / span
        return position, velocity


def main() -> None:
    command_topic, states_topic, *joints = sys.argv[1:]
    rclpy.init()
    node = Controller(command_topic, states_topic, {name: float(at) for name, at in (j.split("=") for j in joints)})
    sys.stdout.write("ready\n")
    sys.stdout.flush()
    rclpy.spin(node)


if __name__ == "__main__":
    main()
