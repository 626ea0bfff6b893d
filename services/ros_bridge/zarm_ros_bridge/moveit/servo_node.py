"""The node of MoveIt Servo: its commands and services, for the same sessions of the servo."""

from __future__ import annotations

from functools import partial
from typing import Any

from control_msgs.msg import JointJog
from geometry_msgs.msg import PoseStamped, TwistStamped
from moveit_msgs.msg import ServoStatus
from moveit_msgs.srv import ServoCommandType
from std_srvs.srv import SetBool, Trigger

from zarm_ros_bridge.convert.servo_commands import joint_speed_of, target_of, twist_of
from zarm_ros_bridge.ros import Ros
from zarm_ros_bridge.servo_commands import COMMANDS, Punctuality, Read, ServoCommands

NAME = "servo_node"
"""The name under which clients of MoveIt Servo find it; on the bus it is no node of its own."""
_TYPES = {
    ServoCommandType.Request.JOINT_JOG: "delta_joint_cmds",
    ServoCommandType.Request.TWIST: "delta_twist_cmds",
    ServoCommandType.Request.POSE: "pose_target_cmds",
}
_EARLIER = ("delta_joint_cmds", "delta_twist_cmds")  # clients of earlier versions select no type


class ServoNode:
    """Passes on commands of the selected type while it is not paused. It begins paused, as MoveIt Servo does."""

    def __init__(self, ros: Ros, commands: ServoCommands) -> None:
        self._commands = commands
        self._accepted: tuple[str, ...] = ()
        self._selected: tuple[str, ...] = _EARLIER
        self._status = ros.node.create_publisher(ServoStatus, f"{NAME}/status", 10)
        commands.report = self._report
        ros.serve(ServoCommandType, f"{NAME}/switch_command_type", self._switch)
        ros.serve(SetBool, f"{NAME}/pause_servo", self._pause)
        ros.serve(Trigger, f"{NAME}/start_servo", self._start)
        ros.serve(Trigger, f"{NAME}/stop_servo", self._stop)
        kinds: tuple[tuple[type[Any], str, Read], ...] = (
            (TwistStamped, "delta_twist_cmds", twist_of),
            (JointJog, "delta_joint_cmds", joint_speed_of),
            (PoseStamped, "pose_target_cmds", target_of),
        )
        for kind, topic, read in kinds:
            taken = partial(self._take, topic, read, Punctuality())
            ros.listen(kind, ros.node.resolve_topic_name(f"{NAME}/{topic}"), taken, COMMANDS)

    def _take(self, topic: str, read: Read, punctuality: Punctuality, message: Any) -> None:
        if topic in self._accepted:
            self._commands.take(topic, read, punctuality, message)

    def _switch(self, request: Any, response: Any) -> Any:
        topic = _TYPES.get(request.command_type)
        response.success = topic is not None
        if topic is not None:
            self._selected = (topic,)
            self._accepted = self._selected if self._accepted else ()
        return response

    def _pause(self, request: Any, response: Any) -> Any:
        self._accepted = () if request.data else self._selected
        response.success = True
        response.message = "commands are ignored" if request.data else "commands are followed"
        return response

    def _start(self, _: Any, response: Any) -> Any:
        self._accepted = self._selected = _EARLIER
        response.success, response.message = True, "commands are followed"
        return response

    def _stop(self, _: Any, response: Any) -> Any:
        self._accepted = ()
        response.success, response.message = True, "commands are ignored"
        return response

    def _report(self, code: int, text: str) -> None:
        self._status.publish(ServoStatus(code=code, message=text))
