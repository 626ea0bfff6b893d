"""Generation B, summer 2026: a goal of execute_trajectory has a target, and its feedback a state."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from zarm_ros_bridge.curobo.convergence import Convergence
from zarm_ros_bridge.curobo.generations.generation import Generation
from zarm_ros_bridge.curobo.motion_requests import MotionRequest, filled

_STATES = {
    "planning": "PLANNING",
    "tracking": "TRACKING",
    "on_target": "ON_TARGET",
    "cancelled": "FAILED",
    "aborted": "FAILED",
}
"""States other than EXECUTING."""


class GenerationB(Generation):
    """v2 of the tutorial."""

    letter = "b"
    planners = 7

    def goal(self, goal: Any, planner: str, joints: Sequence[str]) -> MotionRequest | None:
        """The goal in the field that the planner reads, or in the only one filled in."""
        if not filled(goal, ("target_pose", "target_poses", "target_joint_positions")):
            return None
        return self.motion(goal, planner, joints)

    def feedback(
        self, kind: type[Any], state: str, progress: float, joint_command: Any, convergence: Convergence | None = None
    ) -> Any:
        """Without a `convergence`, as for every planner without a closed loop, the errors stay 0 and `on_target` false."""
        reported = convergence or Convergence()
        return kind(
            state=_STATES.get(state, "EXECUTING"),
            step_progression=progress,
            joint_command=joint_command,
            position_error=reported.position_error,
            orientation_error=reported.orientation_error,
            on_target=reported.on_target,
            hold_count=reported.hold_count,
        )
