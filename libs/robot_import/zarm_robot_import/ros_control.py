"""The ros2_control trajectory controller that a URDF names: the driver of the arm on ROS."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence

from zarm_contract.document import read_document
from zarm_contract.errors import InvalidRequest
from zarm_robot_import.description import Description

_CONTROLLER = re.compile(r"/?[A-Za-z_][\w/]*trajectory_controller")
_TYPE = "joint_trajectory_controller/JointTrajectoryController"


def controlled(robot: Description, joints: Sequence[str]) -> bool:
    """Whether ros2_control moves all of the arm's joints: one <ros2_control> has a command interface for each."""
    return any(
        set(joints)
        <= {joint.get("name") for joint in system.findall("joint") if joint.find("command_interface") is not None}
        for system in robot.source.root.findall("ros2_control")
    )


def trajectory_controller(robot: Description, joints: Sequence[str]) -> str | None:
    """The name, with its namespace, of the controller for exactly these joints; None if the URDF names none.

    It is named by a <param> of the <ros2_control> that has the joints, or in the parameter file of a simulator plugin.
    Raises InvalidRequest if that file is not valid YAML.
    """
    if not controlled(robot, joints):
        return None
    return next(iter([*_stated(robot), *_configured(robot, joints)]), None)


def _stated(robot: Description) -> Iterator[str]:
    for parameter in robot.source.root.iterfind("ros2_control//param"):
        if _CONTROLLER.fullmatch(text := (parameter.text or "").strip()):
            yield text


def _configured(robot: Description, joints: Sequence[str]) -> Iterator[str]:
    for plugin in robot.source.root.iterfind("gazebo/plugin"):
        for element in plugin.findall("parameters"):
            file = robot.source.file((element.text or "").strip())
            if file is None:
                continue
            try:
                found = read_document(file, "a ROS 2 parameter file").data
            except InvalidRequest as error:
                raise InvalidRequest(f"{robot.source.place(element)}: {error}; correct it") from error
            namespace = (plugin.findtext("ros/namespace") or "").strip().strip("/")
            for name, parameters in _controllers(found):
                if sorted(map(str, _listed(parameters.get("joints")))) == sorted(joints):
                    yield f"{namespace}/{name}" if namespace else name


def _controllers(parameters: object) -> Iterator[tuple[str, dict[str, object]]]:
    """Trajectory controllers and their parameters in a ROS 2 parameter file."""
    nodes = {name: _section(node, "ros__parameters") for name, node in _mapping(parameters).items()}
    for name, entry in nodes.get("controller_manager", {}).items():
        if _mapping(entry).get("type") == _TYPE:
            yield name, nodes.get(name, {})


def _listed(value: object) -> list[object]:
    return value if isinstance(value, list) else []


def _section(node: object, key: str) -> dict[str, object]:
    return _mapping(_mapping(node).get(key))


def _mapping(value: object) -> dict[str, object]:
    return value if isinstance(value, dict) else {}
