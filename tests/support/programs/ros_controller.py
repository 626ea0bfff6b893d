"""A stand-in for a robot under ros2_control: JointTrajectoryController and joint_state_broadcaster, as one ROS node.

    python ros_controller.py COMMAND_TOPIC JOINT_STATES_TOPIC JOINT=RAD ... [--topic-alone]

It takes trajectories as the controller's documentation says, on the topic and by its action beside it,
`.../follow_joint_trajectory`: by joint name; linear between points with positions alone, cubic with velocities, quintic with
accelerations; from where it is to a first point later than 0. A new trajectory takes the place of the old one and cancels its goal,
from its stamp on if that is in the future: until then the old one goes on. An empty one or a cancel brakes to rest. Tolerances of a
goal are kept. The joints follow exactly. States come at 100 Hz, joints in alphabetical order, as the broadcaster of UR's driver lists them.

On COMMAND_TOPIC/fault it takes what is wrong from now on: `inactive` rejects goals, `violate` ends the running goal with
PATH_TOLERANCE_VIOLATED, `off 0.2` measures all joints that far (rad) from where they should be, `slow 30` plays at 30 % of the
speed, as a UR with its slider there, 0 as one that is paused; an empty text is no fault. The speed is on
/speed_scaling_state_broadcaster/speed_scaling.
"""

from __future__ import annotations

import itertools
import sys
import threading
import time
from collections.abc import Sequence
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
DECELERATION = 6.0
"""rad/s^2, the controller's `max_deceleration_on_cancel`."""


def seconds(stamp: Any) -> float:
    return float(stamp.sec + stamp.nanosec * 1e-9)


class Splines:
    """Points in time: `times` (N,), and for each position and, if given, velocity and acceleration: `rows` (N, 1 to 3, J)."""

    def __init__(self, times: Sequence[float], rows: Sequence[np.ndarray]) -> None:
        self.times, self.rows = np.array(times), np.array(rows)

    @property
    def duration(self) -> float:
        return float(self.times[-1])

    def at(self, t: float) -> tuple[np.ndarray, np.ndarray]:
        """Position and velocity: the polynomial of the lowest degree that has what is given at both points."""
        if t >= self.duration:
            return self.rows[-1, 0], np.zeros(self.rows.shape[2])
        index = max(int(np.searchsorted(self.times, t, side="right")) - 1, 0)
        span = self.times[index + 1] - self.times[index]
        given = self.rows.shape[1]
        scale = span ** np.arange(given)[:, None]
        ends = np.concatenate((self.rows[index] * scale, self.rows[index + 1] * scale))
        degrees = range(2 * given)
        falling = np.array(
            [[float(np.prod(range(j - d + 1, j + 1))) * (j >= d) for j in degrees] for d in range(given)]
        )
        start = np.array([[value if j == d else 0.0 for j, value in enumerate(row)] for d, row in enumerate(falling)])
        coefficients = np.linalg.solve(np.vstack((start, falling)), ends)
        u = (t - self.times[index]) / span
        position = sum(c * u**j for j, c in enumerate(coefficients))
        velocity = sum(j * c * u ** (j - 1) for j, c in enumerate(coefficients) if j) / span
        return position, velocity


class Braking:
    """From a position with a velocity to rest, each joint by itself."""

    def __init__(self, position: np.ndarray, velocity: np.ndarray) -> None:
        self.position, self.velocity = position, velocity
        self.each = np.abs(velocity) / DECELERATION
        self.duration = float(self.each.max(initial=0.0))

    def at(self, t: float) -> tuple[np.ndarray, np.ndarray]:
        passed = np.minimum(t, self.each)
        slower = np.sign(self.velocity) * DECELERATION * passed
        return self.position + (self.velocity - slower / 2.0) * passed, self.velocity - slower


class Controller(Node):
    def __init__(self, command_topic: str, states_topic: str, joints: dict[str, float], *, action: bool) -> None:
        super().__init__("controller")
        self.names = sorted(joints)
        self.position = np.array([joints[name] for name in self.names])
        self.velocity = np.zeros(len(self.names))
        self.motion: Splines | Braking = Braking(self.position, self.velocity)
        self.next: tuple[float, JointTrajectory] | None = None
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
                goal_callback=self.look_at,
                cancel_callback=lambda _: CancelResponse.ACCEPT,
                callback_group=group,
            )

    def take_fault(self, message: String) -> None:
        self.fault = message.data

    def look_at(self, goal: Any) -> GoalResponse:
        """Reject a goal while inactive, of other joints, whose times do not increase, or that ends in motion."""
        points = goal.trajectory.points
        times = [seconds(point.time_from_start) for point in points]
        fine = (
            self.fault != "inactive"
            and sorted(goal.trajectory.joint_names) == self.names
            and all(a < b for a, b in itertools.pairwise(times))
            and (not points or not any(points[-1].velocities))
        )
        return GoalResponse.ACCEPT if fine else GoalResponse.REJECT

    def carry_out(self, goal: Any) -> Any:
        """Follow a goal in a thread of its own until it is played, cancelled, replaced or at fault."""
        result = FollowJointTrajectory.Result()
        self.take(goal.request.trajectory)
        self.goal = goal
        over = 0.0
        while True:
            if self.goal is not goal:
                result.error_code, result.error_string = result.INVALID_GOAL, "the goal was replaced"
                goal.abort()
                return result
            if goal.is_cancel_requested:
                self.take(JointTrajectory())
                goal.canceled()
                return result
            played = self.next is None and self.played >= self.motion.duration
            if self.fault == "violate" or (not played and self.outside(goal.request.path_tolerance)):
                self.take(JointTrajectory())
                result.error_code, result.error_string = result.PATH_TOLERANCE_VIOLATED, "the elbow is held"
                goal.abort()
                return result
            if played and not self.outside(goal.request.goal_tolerance):
                goal.succeed()
                return result
            over += PERIOD / 2 if played else 0.0
            if played and over > seconds(goal.request.goal_time_tolerance):
                result.error_code, result.error_string = result.GOAL_TOLERANCE_VIOLATED, "a joint is not there"
                goal.abort()
                return result
            time.sleep(PERIOD / 2)

    def outside(self, tolerances: Any) -> bool:
        """Whether a joint is further from where it should be than a tolerance on its position allows; 0 is none."""
        off = self.off()
        return any(0.0 < one.position < off for one in tolerances)

    def off(self) -> float:
        return float(self.fault.removeprefix("off ")) if self.fault.startswith("off ") else 0.0

    def take(self, message: JointTrajectory) -> None:
        """A trajectory begins now, or at its stamp."""
        stamp = seconds(message.header.stamp)
        with self.turn:
            self.goal = None
            if stamp > self.now():
                self.next = stamp, message
            else:
                self.begin(message)

    def now(self) -> float:
        return float(self.get_clock().now().nanoseconds * 1e-9)

    def begin(self, message: JointTrajectory) -> None:
        """Replace what is played by a trajectory, from where the joints are; without points brake."""
        self.next, self.played = None, 0.0
        if not message.points:
            self.motion = Braking(self.position, self.velocity)
            return
        order = [list(message.joint_names).index(name) for name in self.names]
        times = [seconds(point.time_from_start) for point in message.points]
        rows = [
            np.array([np.array(row)[order] for row in (p.positions, p.velocities, p.accelerations) if len(row)])
            for p in message.points
        ]
        if times[0] > 0.0:
            here = np.array((self.position, self.velocity, np.zeros(len(self.names))))
            times, rows = [0.0, *times], [here[: len(rows[0])], *rows]
        self.motion = Splines(times, rows)

    def tick(self) -> None:
        scale = float(self.fault.removeprefix("slow ")) / 100 if self.fault.startswith("slow ") else 1.0
        with self.turn:
            if self.next is not None and self.now() >= self.next[0]:
                self.begin(self.next[1])
            self.played += PERIOD * scale
            self.position, velocity = self.motion.at(self.played)
            self.velocity = velocity * scale
        self.scaling.publish(Float64(data=100 * scale))
        measured = self.position + self.off()
        state = JointState(name=self.names, position=measured.tolist(), velocity=self.velocity.tolist())
        state.header.stamp = self.get_clock().now().to_msg()
        self.states.publish(state)


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
