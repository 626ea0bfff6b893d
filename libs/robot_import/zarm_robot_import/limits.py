"""Joint limits from the URDF, and cautious assumptions for missing ones."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from zarm_robot_import.description import Description, Joint

VELOCITY = {"revolute": 1.0, "continuous": 1.0, "prismatic": 0.1}
"""Default if the URDF gives none (rad/s, m/s): slow for any arm."""
RAMP = 0.5
"""Assumed time (s) from rest to the highest velocity, so that the assumed acceleration is at most `velocity / RAMP`."""
JERK_RAMP = 0.1
"""Assumed time (s) from no acceleration to the highest."""
MOST_ACCELERATION = 5.0
"""Highest acceleration assumed (rad/s²): what the driver of the UR arms calls conservative."""

UNLIMITED = 1e4
"""A joint with a limit beyond this (rad) counts as unlimited."""
SMALLEST = 1e-3
"""A joint with a smaller range (rad, m) or velocity (rad/s, m/s) hardly moves."""
WIDEST, FASTEST = 100.0, 30.0
"""No joint turns further (rad), slides further (m), or moves faster (rad/s, m/s); larger limits are most likely in
degrees or mm.
"""


@dataclass(frozen=True)
class JointLimits:
    """The limits of one joint in rad or m, and s, without positions if it is continuous; `assumed` names those missing in
    the URDF.
    """

    joint: str
    lower: float
    upper: float
    velocity: float
    acceleration: float
    jerk: float
    assumed: tuple[str, ...]


def limits_of(robot: Description, joints: Sequence[Joint]) -> list[JointLimits]:
    """Limits of the arm's joints. Raises InvalidRequest for an inverted one."""
    return [_limits(robot, joint) for joint in joints]


def _limits(robot: Description, joint: Joint) -> JointLimits:
    assumed = []
    lower, upper = joint.lower, joint.upper
    if joint.type == "continuous":
        lower, upper = -math.inf, math.inf
    elif lower is not None and upper is not None and max(-lower, upper) >= UNLIMITED and joint.type == "revolute":
        lower, upper = -2 * math.pi, 2 * math.pi
        assumed.append("range")
    elif lower is not None and upper is not None and lower == upper and lower:
        raise robot.source.fault(
            joint.element,
            f'joint {joint.name} has both its limits at {lower:g}, so it cannot move; correct them, or give it type="fixed"',
        )
    elif lower is None or upper is None or lower == upper:
        if joint.type == "prismatic":
            raise robot.source.fault(
                joint.element, f"joint {joint.name} is prismatic and has no limits; write <limit lower= upper=>"
            )
        lower, upper = -math.pi, math.pi
        assumed.append("range")
    velocity = joint.velocity
    if not velocity:
        velocity = VELOCITY[joint.type]
        assumed.append("velocity")
    acceleration = joint.acceleration
    if acceleration is None:
        acceleration = min(velocity / RAMP, MOST_ACCELERATION)
        assumed.append("acceleration")
    jerk = joint.jerk
    if jerk is None:
        jerk = acceleration / JERK_RAMP
        assumed.append("jerk")
    velocity, acceleration, jerk = (float(f"{value:.6g}") for value in (velocity, acceleration, jerk))
    return JointLimits(joint.name, lower, upper, velocity, acceleration, jerk, tuple(assumed))
