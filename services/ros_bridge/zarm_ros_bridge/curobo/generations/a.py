"""Generation A, December 2025 to March 2026: execute_trajectory executes the last plan, and strategies have numbers."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from zarm_contract.errors import InvalidRequest
from zarm_ros_bridge.curobo.convergence import Convergence
from zarm_ros_bridge.curobo.generations.generation import Generation
from zarm_ros_bridge.curobo.motion_requests import MotionRequest

_ROBOTS = {0: "doosan_m1013", 2: "ur10"}
"""Numbers of SetRobotStrategy that mean whole trajectories to the controller of this robot."""
_EMULATOR = 1


class GenerationA(Generation):
    """v1 of the tutorial."""

    letter = "a"
    planners = 6

    def goal(self, goal: Any, planner: str, joints: Sequence[str]) -> MotionRequest | None:
        """None: a goal has no fields."""
        return None

    def feedback(
        self, kind: type[Any], state: str, progress: float, joint_command: Any, convergence: Convergence | None = None
    ) -> Any:
        """The commanded joints, and the progress."""
        return kind(joint_command=joint_command, step_progression=progress)

    def strategy(self, request: Any, robot_type: str) -> str:
        """By its number."""
        if request.robot_strategy == _EMULATOR:
            return "emulator"
        robot = _ROBOTS.get(request.robot_strategy)
        if robot != robot_type:
            raise InvalidRequest(
                f"{request.robot_strategy} is {robot or 'no robot'}, and this is {robot_type}; use EMULATOR 1 or the number of "
                "this robot, or set the parameter robot_type and call set_robot_strategy as std_srvs/srv/Trigger",
                field="robot_strategy",
            )
        return "joint_trajectory"

    def active(self, strategy: str, robot_type: str) -> str:
        """A sentence."""
        return f"Active strategy: '{strategy}'" + ("" if robot_type == strategy else f" (robot_type '{robot_type}')")
