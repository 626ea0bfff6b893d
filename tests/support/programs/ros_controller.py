"""A stand-in for a robot under ros2_control: JointTrajectoryController and joint_state_broadcaster, as one ROS node.

    python ros_controller.py COMMAND_TOPIC JOINT_STATES_TOPIC JOINT=RAD ... [--topic-alone]

It takes trajectories as the controller does, on the topic and by its action beside it, `.../follow_joint_trajectory`: by joint
name, quintic between points that have velocities and accelerations, a new trajectory replaces the old one from the moment it
arrives and cancels its goal, an empty one or a cancel holds. The joints follow exactly. States come at 100 Hz, joints in
alphabetical order, as the broadcaster of UR's driver lists them.

On COMMAND_TOPIC/fault it takes what is wrong from now on: `inactive` rejects goals, `violate` ends the running goal with
PATH_TOLERANCE_VIOLATED, `slow 30` plays at 30 % of the speed, as a UR with its slider there, 0 as one that is paused; an empty text is
no fault. The speed is on /speed_scaling_state_broadcaster/speed_scaling.
"""

from __future__ import annotations

import sys
import threading
import time
from typing import Any

import numpy as np
import rclpy
from control_msgs.action import FollowJointTrajectory
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.executors import MultiThreadedExecutor
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64, String
from trajectory_msgs.msg import JointTrajectory

PERIOD = 0.01


class Controller(Node):
    def __init__(self, command_topic: str, states_topic: str, joints: dict[str, float], *, action: bool) -> None:
        super().__init__("controller")
        self.names = sorted(joints)
        self.position = np.array([joints[name] for name in self.names])
        self.velocity = np.zeros(len(self.names))
        self.times = np.zeros(0)
        self.rows = np.zeros((0, 3, len(self.names)))
        self.played = 0.0
        self.scaling = self.create_publisher(Float64, "/speed_scaling_state_broadcaster/speed_scaling", 10)
        self.states = self.create_publisher(JointState, states_topic, 10)
        self.fault = ""
        self.turn = threading.Lock()  # between the goals' threads and the one that plays
        self.goal: Any = None
        group = ReentrantCallbackGroup()
        self.create_subscription(JointTrajectory, command_topic, self.take, 10)
        self.create_subscription(String, f"{command_topic}/fault", self.take_fault, 10)
        self.create_timer(PERIOD, self.tick)
        if action:
            self.action = ActionServer(
                self,
                FollowJointTrajectory,
                f"{command_topic.rpartition('/')[0]}/follow_joint_trajectory",
                self.carry_out,
                goal_callback=lambda _: GoalResponse.REJECT if self.fault == "inactive" else GoalResponse.ACCEPT,
                cancel_callback=lambda _: CancelResponse.ACCEPT,
                callback_group=group,
            )

    def take_fault(self, message: String) -> None:
        self.fault = message.data

    def carry_out(self, goal: Any) -> Any:
        """Follow a goal in a thread of its own until it is played, cancelled, replaced or at fault."""
        result = FollowJointTrajectory.Result()
        self.goal = goal
        self.take(goal.request.trajectory)
        self.goal = goal
        while self.goal is not goal or (self.times.size and self.played < self.times[-1]):
            if self.goal is not goal:
                result.error_code, result.error_string = result.INVALID_GOAL, "the goal was replaced"
                goal.abort()
                return result
            if goal.is_cancel_requested:
                self.take(JointTrajectory())
                goal.canceled()
                return result
            if self.fault == "violate":
                self.take(JointTrajectory())
                result.error_code = result.PATH_TOLERANCE_VIOLATED
                result.error_string = "the elbow is held"
                goal.abort()
                return result
            time.sleep(PERIOD / 2)
        goal.succeed()
        return result

    def take(self, message: JointTrajectory) -> None:
        times = np.array([p.time_from_start.sec + p.time_from_start.nanosec * 1e-9 for p in message.points])
        order = [list(message.joint_names).index(name) for name in self.names] if message.points else []
        rows = np.array(
            [[np.array(row)[order] for row in (p.positions, p.velocities, p.accelerations)] for p in message.points]
        )
        with self.turn:
            self.goal, self.played, self.times, self.rows = None, 0.0, times, rows
            if not times.size:
                self.velocity = np.zeros(len(self.names))

    def tick(self) -> None:
        scale = float(self.fault.removeprefix("slow ")) / 100 if self.fault.startswith("slow ") else 1.0
        with self.turn:
            if self.times.size:
                self.played += PERIOD * scale
                self.position, velocity = self.at(self.played)
                self.velocity = velocity * scale
        self.scaling.publish(Float64(data=100 * scale))
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
    command_topic, states_topic, *rest = sys.argv[1:]
    joints = dict(word.split("=") for word in rest if "=" in word)
    rclpy.init()
    at = {name: float(value) for name, value in joints.items()}
    node = Controller(command_topic, states_topic, at, action="--topic-alone" not in rest)
    sys.stdout.write("ready\n")
    sys.stdout.flush()
    executor = MultiThreadedExecutor(4)
    executor.add_node(node)
    executor.spin()


if __name__ == "__main__":
    main()
