"""Errors as MoveItErrorCodes."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

from moveit_msgs.msg import MoveItErrorCodes as Val

from zarm_contract.errors import Code, InvalidRequest, ZarmError
from zarm_ros_bridge.answers import shortened
from zarm_ros_bridge.transforms import UnknownFrame

SOURCE = "zarm"

OF_CODE: Mapping[Code, int] = {
    "invalid_request": Val.FAILURE,
    "unreachable": Val.NO_IK_SOLUTION,
    "start_in_collision": Val.START_STATE_IN_COLLISION,
    "goal_in_collision": Val.GOAL_IN_COLLISION,
    "no_path": Val.PLANNING_FAILED,
    "timeout": Val.TIMED_OUT,
    "stale_plan": Val.MOTION_PLAN_INVALIDATED_BY_ENVIRONMENT_CHANGE,
    "start_state_mismatch": Val.CONTROL_FAILED,
    "no_joint_state": Val.ROBOT_STATE_STALE,
    "limit_violated": Val.INVALID_MOTION_PLAN,
    "busy": Val.CONTROL_FAILED,
    "unavailable": Val.COMMUNICATION_FAILURE,
    "tolerance_violated": Val.CONTROL_FAILED,
    "driver_stalled": Val.CONTROL_FAILED,
    "collision_detected": Val.CONTROL_FAILED,
    "cancelled": Val.PREEMPTED,
    "internal": Val.FAILURE,
}
"""Each code of a problem as a value of MoveItErrorCodes."""
_OF_FIELD: Mapping[str, int] = {
    "goal": Val.INVALID_GOAL_CONSTRAINTS,
    "goal_constraints": Val.INVALID_GOAL_CONSTRAINTS,
    "waypoints": Val.INVALID_GOAL_CONSTRAINTS,
    "poses": Val.INVALID_GOAL_CONSTRAINTS,
    "start": Val.START_STATE_INVALID,
    "start_state": Val.START_STATE_INVALID,
    "robot_state": Val.INVALID_ROBOT_STATE,
    "joints": Val.INVALID_ROBOT_STATE,
    "path_constraints": Val.INVALID_MOTION_PLAN,
    "trajectory": Val.INVALID_MOTION_PLAN,
    "tip": Val.INVALID_LINK_NAME,
}
"""The value for an invalid request, by the first part of the field."""


class Refusal(InvalidRequest):
    """A request that is refused with the value `val` of MoveItErrorCodes."""

    def __init__(self, val: int, message: str, field: str | None = None) -> None:
        super().__init__(message, field=field)
        self.val = val


def val_of(error: ZarmError) -> int:
    """The value of MoveItErrorCodes for an error."""
    if isinstance(error, Refusal):
        return error.val
    if isinstance(error, UnknownFrame):
        return int(Val.FRAME_TRANSFORM_FAILURE)
    if error.code == "invalid_request" and error.problem.field is not None:
        return int(_OF_FIELD.get(re.split(r"[.\[]", error.problem.field)[0], Val.FAILURE))
    return int(OF_CODE[error.code])


def error_code(error: ZarmError | None) -> Any:
    """The message for an error, or for success, with the sentence where the installed moveit_msgs has a field for it."""
    code = Val(val=Val.SUCCESS if error is None else val_of(error))
    if hasattr(code, "message"):
        code.message, code.source = "" if error is None else shortened(str(error)), SOURCE
    return code
