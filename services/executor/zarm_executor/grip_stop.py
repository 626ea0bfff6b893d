"""A stop of a goal at which a gripper moves before the robot goes on."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from zarm_contract.errors import Problem
from zarm_contract.messages import GripperRequest, Hold, PlannedGrip
from zarm_executor.gripper_control import GripperControl

REST_SHARE = 0.6
"""The robot is held within this share of the time for which it rests at a stop."""


@dataclass(frozen=True)
class GripStop:
    """The robot waits before the path time `until` (s), within the rest that is planned there, while `control` carries `grip` out."""

    until: float
    grip: PlannedGrip
    control: GripperControl
    hold: ClassVar = Hold(reason="gripper")

    def begin(self, goal_id: str) -> None:
        """Move the gripper for this goal. Raises what `GripperControl.start` raises."""
        grip = self.grip
        self.control.start(GripperRequest(width=grip.width, force=grip.force, speed=grip.speed), goal_id)

    @property
    def moving(self) -> bool:
        """Whether the gripper still moves."""
        return self.control.moving

    def problem(self, goal_id: str) -> Problem | None:
        """Why the goal cannot go on now that the fingers stand; None if it can."""
        state, grip = self.control.state(), self.grip
        if state.goal_id != goal_id:
            return Problem(code="cancelled", message=f"another goal moved {state.gripper} meanwhile; plan again")
        if state.problem is not None:
            return state.problem
        if state.width is None or abs(state.width - grip.width) > grip.tolerance:
            stands = "nowhere" if state.width is None else f"at {state.width:.4f} m"
            return Problem(
                code="tolerance_violated",
                message=f"the fingers of {state.gripper} stand {stands}, not at {grip.width:g} m (tolerance {grip.tolerance:g} m), with which "
                "the rest was verified; see what they hold, and plan again",
            )
        return None

    def cancel(self, why: str) -> None:
        """Stop the fingers, if they move."""
        self.control.cancel(why)
