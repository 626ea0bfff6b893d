"""The two actions of ros2_control's gripper controllers, and what their fields say."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from control_msgs.action import GripperCommand, ParallelGripperCommand
from control_msgs.msg import GripperCommand as Command
from sensor_msgs.msg import JointState

from zarm_contract.errors import InvalidRequest


@dataclass(frozen=True)
class Move:
    """Where a joint goes (rad, m), its greatest speed (rad/s, m/s) and the greatest force of the gripper (N); 0 is the greatest there is."""

    position: float
    speed: float = 0.0
    force: float = 0.0


@dataclass(frozen=True)
class Dialect:
    """An action of the type `kind`: `read(goal, joint)` says what a goal asks for and raises InvalidRequest, `write(move, joint)` is the goal for it,
    `position(message)` is the position in its feedback or result, and `put(message, joint, position)` sets it. The `prefix` begins the name of the controller,
    and the field `effort` of a goal has the force.
    """

    kind: Any
    prefix: str
    effort: str
    read: Callable[[Any, str], Move]
    write: Callable[[Move, str], Any]
    position: Callable[[Any], float]
    put: Callable[[Any, str, float], None]


def _read(goal: Any, _: str) -> Move:
    return Move(goal.command.position, force=goal.command.max_effort)


def _write(move: Move, _: str) -> Any:
    return GripperCommand.Goal(command=Command(position=move.position, max_effort=move.force))


def _put(message: Any, _: str, position: float) -> None:
    message.position = position


def _read_parallel(goal: Any, joint: str) -> Move:
    command = goal.command
    names = list(command.name)
    if names and joint not in names:
        raise InvalidRequest(
            f"{', '.join(names)} is not the joint of the gripper, which is {joint}", field="command.name"
        )
    index = names.index(joint) if names else 0
    if len(command.position) <= index:
        raise InvalidRequest("there is no position; give one for each name", field="command.position")
    speed, force = ((field[index] if len(field) > index else 0.0) for field in (command.velocity, command.effort))
    return Move(command.position[index], speed, force)


def _write_parallel(move: Move, joint: str) -> Any:
    command = JointState(name=[joint], position=[move.position])
    command.velocity, command.effort = ([value] if value else [] for value in (move.speed, move.force))
    return ParallelGripperCommand.Goal(command=command)


def _position_parallel(message: Any) -> float:
    return message.state.position[0] if message.state.position else math.nan


def _put_parallel(message: Any, joint: str, position: float) -> None:
    message.state = JointState(name=[joint], position=[position])


GRIPPER = Dialect(
    GripperCommand, "", "command.max_effort", _read, _write, lambda message: float(message.position), _put
)
"""Of GripperActionController."""
PARALLEL = Dialect(
    ParallelGripperCommand,
    "parallel_",
    "command.effort",
    _read_parallel,
    _write_parallel,
    _position_parallel,
    _put_parallel,
)
"""Of ParallelGripperActionController, which takes its place in newer distributions."""
DIALECTS = {
    "control_msgs/action/GripperCommand": GRIPPER,
    "control_msgs/action/ParallelGripperCommand": PARALLEL,
}
