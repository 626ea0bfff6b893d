"""A client of the actions of /unified_planner, and motions for it."""

from __future__ import annotations

import time
from typing import Any

from action_msgs.msg import GoalStatus
from geometry_msgs.msg import Point, Pose, Quaternion
from rclpy.action import ActionClient
from rclpy.node import Node
from rclpy.qos import QoSProfile

from curobo_msgs.action import SendTrajectory
from support.harness import PATIENCE, eventually
from support.ros.node import answer, on_its_thread
from zarm_contract.keys import Keys
from zarm_contract.messages import ExecutorState, JointGoal, JointState, Plan, PlanRequest
from zarm_contract.robot import load_robot
from zarm_runtime.bus import Bus

SUCCEEDED, CANCELED, ABORTED = GoalStatus.STATUS_SUCCEEDED, GoalStatus.STATUS_CANCELED, GoalStatus.STATUS_ABORTED
TARGET = Pose(position=Point(x=0.5, y=0.2, z=0.4), orientation=Quaternion(x=0.0, y=1.0, z=0.0, w=0.0))
"""A pose within reach of the M1013."""
HOME = load_robot("doosan_m1013").descriptor.home


class Sent:
    """A goal and everything its client receives about it."""

    def __init__(self, node: Node, client: ActionClient, goal: Any) -> None:
        self.feedback: list[Any] = []
        self._node = node
        self._answer = on_its_thread(
            node,
            lambda: client.send_goal_async(
                goal, feedback_callback=lambda reported: self.feedback.append(reported.feedback)
            ),
        )
        self._result: Any = None

    @property
    def accepted(self) -> bool:
        """Whether the goal was accepted; waits for the answer."""
        self.handle = answer(self._answer, "the goal is answered")
        return bool(self.handle.accepted)

    def under_way(self) -> None:
        """Wait until the robot is in the middle of the motion."""
        moving = lambda: any(0.1 < reported.step_progression < 0.9 for reported in self.feedback)  # noqa: E731
        ended = self._ask_for_result()
        eventually(lambda: moving() or ended.done(), "the robot moves")
        assert moving(), ended.result().result.message

    def ended(self) -> tuple[int, Any]:
        """The final status, and the result."""
        response = answer(self._ask_for_result(), "the goal ends")
        return response.status, response.result

    def asked_again(self) -> tuple[int, Any]:
        """The same from the action's present server, if it was replaced."""
        self._result = None
        return self.ended()

    def _ask_for_result(self) -> Any:
        assert self.accepted
        if self._result is None:
            self._result = on_its_thread(self._node, self.handle.get_result_async)
        return self._result

    def cancel(self) -> None:
        """Cancel it, which must be accepted."""
        response = answer(on_its_thread(self._node, self.handle.cancel_goal_async), "the cancel is answered")
        assert len(response.goals_canceling) == 1


class Actions:
    """Sends goals of one action."""

    def __init__(self, node: Node, name: str = "execute_trajectory", kind: Any = SendTrajectory) -> None:
        self._node = node
        self._kind = kind
        many = QoSProfile(depth=1000)  # with the default depth of 10, further replies are lost
        self._client = ActionClient(
            node,
            kind,
            f"/unified_planner/{name}",
            goal_service_qos_profile=many,
            result_service_qos_profile=many,
            feedback_sub_qos_profile=many,
        )

    def send(self, **goal: Any) -> Sent:
        """Send a goal with these fields."""
        assert self._client.wait_for_server(PATIENCE)
        return Sent(self._node, self._client, self._kind.Goal(**goal))


class Robot:
    """The robot as a client on the bus sees it."""

    def __init__(self, bus: Bus, keys: Keys) -> None:
        self.bus = bus
        self.keys = keys
        self._measured = bus.latest(keys.joint_states)

    def joints(self) -> tuple[float, ...]:
        """Its position (rad)."""
        return eventually(lambda: self._measured.get(max_age=0.5), "the joints are measured").position

    def state(self) -> ExecutorState:
        """The state of its executor."""
        return self.bus.read(self.keys.executor_state, timeout=10)

    def rests(self) -> bool:
        """Whether it has no goal and its joints, measured from now on, stand."""
        now = time.time()

        def measured() -> JointState | None:
            latest = self._measured.get(max_age=0.5)
            return latest if latest is not None and latest.stamp > now else None

        velocity = eventually(measured, "the joints are measured").velocity
        return self.state().goal_id is None and not any(velocity)

    def wait_rest(self) -> None:
        """Wait until it rests."""
        eventually(self.rests, "the robot rests")

    def plan(self, *, speed: float = 0.3) -> Plan:
        """A plan of about 0.8 rad of the first joint, at this share of the speed: seconds of motion."""
        self.wait_rest()
        goal = (-0.4 if self.joints()[0] > 0.0 else 0.4, *HOME[1:])
        request = PlanRequest(goal=JointGoal(kind="joints", position=goal), velocity_scale=speed)
        return self.bus.call(self.keys.plan, request, timeout=PATIENCE)
