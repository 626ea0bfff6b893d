"""Compares poses measured on the real arm with the descriptor's kinematics, and explains differences."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from zarm_contract.errors import InvalidRequest
from zarm_contract.messages import Quaternion
from zarm_contract.robot import RobotDescription
from zarm_geometry.frames import rotation
from zarm_geometry.robot_model import RobotModel
from zarm_trajectory.arrays import Array

TOLERANCE = 0.005
"""Tips further apart than this (m) differ: more than an arm's nominal kinematics are off, less than the effect of any
wrong axis.
"""
_ANGLE = 0.02
"""The same for orientations (rad)."""
_FLIPPED = 3
"""Most joints assumed to turn the other way."""


@dataclass(frozen=True)
class Measured:
    """Joints (rad, m), and the tip measured there: its position (m, base frame) and, if known, orientation `x, y, z,
    w`.
    """

    joints: Array
    position: Array
    orientation: Quaternion | None


@dataclass(frozen=True)
class Comparison:
    """The distance of each measured tip from the descriptor's (m, and rad if measured), and what explains it."""

    distances: list[float]
    angles: list[float | None]
    explanation: str | None

    @property
    def fits(self) -> bool:
        """Whether every tip is where it was measured."""
        return max(self.distances) <= TOLERANCE and all(angle is None or angle <= _ANGLE for angle in self.angles)

    def as_dict(self) -> dict[str, object]:
        """Its JSON form."""
        return {"distances": self.distances, "angles": self.angles, "explanation": self.explanation}

    def lines(self) -> Iterator[str]:
        """A line for each pose, and one with the remedy."""
        for number, (distance, angle) in enumerate(zip(self.distances, self.angles, strict=True), 1):
            turned = "" if angle is None else f", {math.degrees(angle):.2f} deg"
            yield f"pose {number}: {1e3 * distance:.1f} mm{turned} from the descriptor's"
        if self.fits:
            yield "all measured poses fit"
        elif self.explanation:
            yield f"they all fit if {self.explanation}"
        else:
            yield "no simple mistake explains them; look at the frames of base_link and tip_link, and at the URDF's lengths"


def parse(text: str, dof: int) -> Measured:
    """`J1,...,Jn=X,Y,Z` or `J1,...,Jn=X,Y,Z,QX,QY,QZ,QW`. Raises InvalidRequest."""
    try:
        joints, pose = ([float(value) for value in side.split(",")] for side in text.split("="))
    except ValueError:
        joints, pose = [], []
    norm = math.hypot(*pose[3:])
    if len(joints) != dof or len(pose) not in (3, 7) or not all(map(math.isfinite, (*joints, *pose))):
        raise InvalidRequest(
            f"{text!r} is not a measured pose; write {dof} joints (rad), =, and x,y,z (m) or x,y,z,qx,qy,qz,qw of the tip in the base "
            "frame",
            field="--calibrate",
        )
    if len(pose) == 7 and abs(norm - 1.0) > 0.01:
        raise InvalidRequest(f"{text!r}: the quaternion has the norm {norm:.3g}, not 1", field="--calibrate")
    orientation = None
    if len(pose) == 7:
        x, y, z, w = (value / norm for value in pose[3:])
        orientation = x, y, z, w
    return Measured(np.array(joints), np.array(pose[:3]), orientation)


def compare(robot: RobotDescription, poses: Sequence[str]) -> Comparison:
    """The descriptor's tips compared with measured ones, see `parse`, and the simplest explanation that makes all of
    them fit.
    """
    model = RobotModel.of(robot)
    measured = [parse(pose, model.dof) for pose in poses]
    found = _compared(model, measured, "")
    if found.fits:
        return replace(found, explanation=None)
    tried = (_compared(model, changed, why) for changed, why in _explanations(model, measured))
    fitting = next((each for each in tried if each.fits), None)
    return replace(found, explanation=fitting.explanation if fitting else None)


def _compared(model: RobotModel, measured: Sequence[Measured], explanation: str) -> Comparison:
    distances, angles = [], []
    for one in measured:
        tip = model.fk_tip(one.joints)
        distances.append(float(np.linalg.norm(tip[:3, 3] - one.position)))
        angle = None
        if one.orientation is not None:
            turn = tip[:3, :3].T @ rotation(one.orientation)
            angle = math.acos(min(1.0, max(-1.0, (float(np.trace(turn)) - 1.0) / 2.0)))
        angles.append(angle)
    return Comparison(distances, angles, explanation)


def _explanations(model: RobotModel, measured: Sequence[Measured]) -> Iterator[tuple[list[Measured], str]]:
    """The poses under each possible explanation; the simplest first."""
    yield [replace(one, position=one.position / 1000) for one in measured], "the positions are in mm"
    yield [replace(one, joints=np.radians(one.joints)) for one in measured], "the joints are in degrees"
    yield (
        [replace(one, joints=np.radians(one.joints), position=one.position / 1000) for one in measured],
        "the joints are in degrees and the positions in mm",
    )
    names = model.robot.descriptor.joints
    for count in range(1, _FLIPPED + 1):
        for flipped in combinations(range(model.dof), count):
            sign = np.ones(model.dof)
            sign[list(flipped)] = -1.0
            which = " and ".join(names[joint] for joint in flipped)
            verb = "turns" if count == 1 else "turn"
            yield (
                [replace(one, joints=one.joints * sign) for one in measured],
                f"{which} {verb} the other way: mirror the axis",
            )
    if len(measured) > 1:
        offset = _tool(model, measured)
        moved = [replace(one, position=one.position - model.fk_tip(one.joints)[:3, :3] @ offset) for one in measured]
        x, y, z = ((1e3 * offset).round(1) + 0.0).tolist()
        yield moved, f"what was measured is another point, {x:g}, {y:g}, {z:g} mm from the tip in its own frame"


def _tool(model: RobotModel, measured: Sequence[Measured]) -> Array:
    """The constant offset (3,) in the tip's frame that brings the tips closest to the measured ones, by least squares."""
    tips = [model.fk_tip(one.joints) for one in measured]
    beside = [tip[:3, :3].T @ (one.position - tip[:3, 3]) for tip, one in zip(tips, measured, strict=True)]
    found: Array = np.mean(beside, axis=0)
    return found
