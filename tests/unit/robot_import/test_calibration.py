"""`zarm robot check --calibrate` compares measured poses, and says which simple mistake explains them."""

from __future__ import annotations

import numpy as np
import pytest

from zarm_contract.errors import InvalidRequest
from zarm_contract.robot import load_robot
from zarm_geometry.robot_model import RobotModel
from zarm_robot_import.calibration import compare, parse
from zarm_trajectory.arrays import Array

ROBOT = load_robot("ur5e")
MODEL = RobotModel.of(ROBOT)
JOINTS = np.random.default_rng(0).uniform(-2.0, 2.0, (4, 6))


def reported(joints: Array, position: Array, orientation: str = "") -> str:
    return f"{','.join(map(repr, joints.tolist()))}={','.join(map(repr, position.tolist()))}{orientation}"


def tips(joints: Array) -> Array:
    return np.asarray(MODEL.fk_tip(joints)[:, :3, 3])


def test_poses_of_the_same_arm_fit() -> None:
    found = compare(ROBOT, [reported(q, tip + 0.001) for q, tip in zip(JOINTS, tips(JOINTS), strict=True)])
    assert found.fits
    assert found.explanation is None
    assert found.distances == pytest.approx([0.001 * np.sqrt(3)] * 4)


@pytest.mark.parametrize("flipped", [(2,), (1, 4)])
def test_mirrored_axes_are_named(flipped: tuple[int, ...]) -> None:
    real = JOINTS.copy()
    real[:, flipped] *= -1.0
    found = compare(ROBOT, [reported(q, tip) for q, tip in zip(JOINTS, tips(real), strict=True)])
    assert not found.fits
    assert found.explanation is not None
    assert all(ROBOT.descriptor.joints[joint] in found.explanation for joint in flipped)


def test_units_and_another_point_are_named() -> None:
    in_degrees = compare(ROBOT, [reported(np.degrees(q), tip) for q, tip in zip(JOINTS, tips(JOINTS), strict=True)])
    assert in_degrees.explanation == "the joints are in degrees"
    in_millimetres = compare(ROBOT, [reported(q, 1000 * tip) for q, tip in zip(JOINTS, tips(JOINTS), strict=True)])
    assert in_millimetres.explanation == "the positions are in mm"
    beside = MODEL.fk_tip(JOINTS) @ [0.0, 0.0, 0.12, 1.0]
    gripper = compare(ROBOT, [reported(q, point[:3]) for q, point in zip(JOINTS, beside, strict=True)])
    assert gripper.explanation == "what was measured is another point, 0, 0, 120 mm from the tip in its own frame"


def test_an_orientation_counts() -> None:
    found = compare(ROBOT, [reported(JOINTS[0], tips(JOINTS)[0], ",0,0,0,1")])
    assert not found.fits
    assert found.explanation is None


@pytest.mark.parametrize(
    "text", ["", "1,2,3=1,2,3", "0,0,0,0,0,0=0,0", "0,0,0,0,0,nan=0,0,0", "0,0,0,0,0,0=0,0,0,1,1,1,1"]
)
def test_what_is_no_pose_is_refused(text: str) -> None:
    with pytest.raises(InvalidRequest) as caught:
        parse(text, 6)
    assert caught.value.problem.field == "--calibrate"
