"""Checks of a robot beyond its descriptor's schema: its geometry, and measured poses."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from zarm_contract.errors import Unavailable
from zarm_contract.robot import RobotDescription

if TYPE_CHECKING:
    from zarm_robot_import.calibration import Comparison


def findings(robot: RobotDescription) -> list[str]:
    """What is most likely wrong, a sentence each. Raises Unavailable without the packages of the planner."""
    try:
        from zarm_robot_import import checking
    except ImportError as error:
        raise _missing(error) from error
    return checking.findings(robot)


def compare(robot: RobotDescription, poses: Sequence[str]) -> Comparison:
    """Measured poses, `JOINTS=POSE`, against the robot's kinematics. Raises InvalidRequest, Unavailable."""
    try:
        from zarm_robot_import import calibration
    except ImportError as error:
        raise _missing(error) from error
    return calibration.compare(robot, poses)


def _missing(error: ImportError) -> Unavailable:
    return Unavailable(
        f"robots cannot be checked, because {error.name} cannot be imported here; `pip install 'zarm[planner,import]'`"
    )
