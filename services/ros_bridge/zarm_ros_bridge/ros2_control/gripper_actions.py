"""gripper_cmd: each gripper of the robot as a gripper controller of ros2_control."""

from __future__ import annotations

import math
from functools import partial
from typing import Any

from zarm_contract.errors import InvalidRequest, ZarmError
from zarm_contract.gripper import Gripper
from zarm_contract.messages import GripperState
from zarm_ros_bridge.action_servers import Action, ActionServers
from zarm_ros_bridge.engine import Engine
from zarm_ros_bridge.goals import Run
from zarm_ros_bridge.gripper_dialects import DIALECTS, Dialect
from zarm_ros_bridge.ros import Ros

ONLY = "gripper_action_controller/gripper_cmd"
"""The action of a robot's only gripper, relative to the namespace of the bridge; one of several has its own name in place of
`gripper_action`.
"""
_SLACK = 1e-3
"""By how much a position may be outside of the range (rad, m) and counts as its end."""


class GripperActions:
    """Serves the actions, in either dialect. As for a controller, a new goal takes the place of the one that runs, positions are those of the joint
    (rad, m), and an effort of 0 means the greatest force; what a gripper cannot give is not asked of it.
    """

    def __init__(self, ros: Ros, engine: Engine, servers: ActionServers) -> None:
        self._engine = engine
        self._log = ros.node.get_logger()
        grippers = engine.robot.descriptor.grippers
        for name, gripper in grippers.items():
            action = ONLY if len(grippers) == 1 else f"{name}_controller/gripper_cmd"
            for dialect in DIALECTS.values():
                servers.serve(
                    ros,
                    Action(
                        dialect.kind,
                        f"{dialect.prefix}{action}",
                        f"{dialect.prefix}gripper_{name}",
                        partial(self._move, name, gripper, dialect),
                        partial(self._failed, name, gripper, dialect),
                        moves=lambda _: False,
                    ),
                )

    def _move(self, name: str, gripper: Gripper, dialect: Dialect, run: Run) -> Any:
        if run.taken_up:
            raise InvalidRequest("the bridge was started again; send the goal again")
        move = dialect.read(run.handle.request, gripper.joint)
        low, high = sorted((gripper.positions[0], gripper.positions[-1]))
        if not (math.isfinite(move.position) and low - _SLACK <= move.position <= high + _SLACK):
            raise InvalidRequest(
                f"{move.position:g} is outside of the range of {gripper.joint}, {low:g} to {high:g}",
                field="command.position",
            )
        if not (math.isfinite(move.force) and move.force >= 0.0):
            raise InvalidRequest(f"{move.force:g} is no force; give one in N, or 0", field=dialect.effort)
        if not (math.isfinite(move.speed) and move.speed >= 0.0):
            raise InvalidRequest(f"{move.speed:g} is no speed; give a positive one, or none", field="command.velocity")

        def report(state: GripperState) -> None:
            run.go_on()
            feedback = dialect.kind.Feedback()
            _fill(feedback, dialect, gripper, state)
            run.handle.publish_feedback(feedback)

        state = self._engine.client.gripper.move(
            gripper.width(move.position),
            name,
            force=min(move.force, gripper.force) or None,
            speed=min(move.speed / gripper.joint_speed, gripper.speed) or None,
            preempt=True,
            on_progress=report,
        )
        result = dialect.kind.Result()
        _fill(result, dialect, gripper, state)
        return result

    def _failed(self, name: str, gripper: Gripper, dialect: Dialect, error: ZarmError, text: str) -> Any:
        self._log.warning(f"gripper_cmd: {text}")
        try:
            position = self._engine.client.gripper.state(name).position
        except ZarmError:
            position = None
        result = dialect.kind.Result()
        dialect.put(result, gripper.joint, math.nan if position is None else position)
        return result


def _fill(message: Any, dialect: Dialect, gripper: Gripper, state: GripperState) -> None:
    dialect.put(message, gripper.joint, math.nan if state.position is None else state.position)
    if hasattr(message, "stalled"):  # the feedback of one has no more than the position
        message.stalled, message.reached_goal = state.status == "stalled", state.status == "reached"
