"""gripper_cmd: each gripper of the robot as a gripper controller of ros2_control."""

from __future__ import annotations

import math
from functools import partial
from typing import Any

from control_msgs.action import GripperCommand

from zarm_contract.errors import InvalidRequest, ZarmError
from zarm_contract.gripper import Gripper
from zarm_contract.messages import GripperState
from zarm_ros_bridge.action_servers import Action, ActionServers
from zarm_ros_bridge.engine import Engine
from zarm_ros_bridge.goals import Run
from zarm_ros_bridge.ros import Ros

ONLY = "gripper_action_controller/gripper_cmd"
"""The action of a robot's only gripper, relative to the namespace of the bridge; one of several has its own name in place of
`gripper_action`.
"""
_SLACK = 1e-3
"""By how much a position may be outside of the range (rad, m) and counts as its end."""


class GripperActions:
    """Serves the actions. As for a controller, a new goal takes the place of the one that runs, positions are those of the joint
    (rad, m), and `max_effort` 0 means the greatest force; what a gripper cannot give is not asked of it.
    """

    def __init__(self, ros: Ros, engine: Engine, servers: ActionServers) -> None:
        self._engine = engine
        self._log = ros.node.get_logger()
        grippers = engine.robot.descriptor.grippers
        for name, gripper in grippers.items():
            action = ONLY if len(grippers) == 1 else f"{name}_controller/gripper_cmd"
            servers.serve(
                ros,
                Action(
                    GripperCommand,
                    action,
                    f"gripper_{name}",
                    partial(self._move, name, gripper),
                    partial(self._failed, name),
                    moves=lambda _: False,
                ),
            )

    def _move(self, name: str, gripper: Gripper, run: Run) -> Any:
        if run.taken_up:
            raise InvalidRequest("the bridge was started again; send the goal again")
        command = run.handle.request.command
        low, high = sorted((gripper.positions[0], gripper.positions[-1]))
        if not (math.isfinite(command.position) and low - _SLACK <= command.position <= high + _SLACK):
            raise InvalidRequest(
                f"{command.position:g} is outside of the range of {gripper.joint}, {low:g} to {high:g}",
                field="command.position",
            )
        if not (math.isfinite(command.max_effort) and command.max_effort >= 0.0):
            raise InvalidRequest(f"{command.max_effort:g} is no force; give one in N, or 0", field="command.max_effort")

        def report(state: GripperState) -> None:
            run.go_on()
            run.handle.publish_feedback(_filled(GripperCommand.Feedback(), state))

        state = self._engine.client.gripper.move(
            gripper.width(command.position),
            name,
            force=min(command.max_effort, gripper.force) or None,
            preempt=True,
            on_progress=report,
        )
        return _filled(GripperCommand.Result(), state)

    def _failed(self, name: str, error: ZarmError, text: str) -> Any:
        self._log.warning(f"gripper_cmd: {text}")
        try:
            position = self._engine.client.gripper.state(name).position
        except ZarmError:
            position = None
        return GripperCommand.Result(position=math.nan if position is None else position)


def _filled(message: Any, state: GripperState) -> Any:
    message.position = math.nan if state.position is None else state.position
    message.stalled, message.reached_goal = state.status == "stalled", state.status == "reached"
    return message
