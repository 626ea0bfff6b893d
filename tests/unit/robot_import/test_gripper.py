"""Grippers are found by structure: one drive, joints that mimic it, fingers that open."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from zarm_contract.robot import RobotDescription, load_robot
from zarm_geometry.robot_model import RobotModel
from zarm_robot_import.importing import Options, import_robot
from zarm_robot_import.report import Report

LINK = '<link name="{0}"><collision><geometry><box size="{1}"/></geometry></collision></link>'
JOINT = (
    '<joint name="{0}" type="{1}"><parent link="{2}"/><child link="{3}"/><origin xyz="{4}"/><axis xyz="{5}"/>'
    '<limit lower="{6}" upper="{7}" velocity="{8}" effort="30"/>{9}</joint>'
)
BOX = "0.06 0.06 0.15"
ARM = [
    LINK.format("link_0", BOX),
    *(
        LINK.format(f"link_{k + 1}", BOX)
        + JOINT.format(f"joint_{k}", "revolute", f"link_{k}", f"link_{k + 1}", "0 0 0.2", axis, -2, 2, 1, "")
        for k, axis in enumerate(("0 0 1", "0 1 0", "0 1 0", "0 0 1", "0 1 0"))
    ),
]
FINGER = "0.02 0.01 0.06"


def slide(name: str, axis: str, more: str = "", parent: str = "link_5") -> str:
    """A finger whose inner face is in the middle of the hand at 0."""
    side = 0.005 if axis == "0 1 0" else -0.005
    return LINK.format(name, FINGER) + JOINT.format(
        f"{name}_joint", "prismatic", parent, name, f"0 {side} 0.12", axis, 0.0, 0.03, 0.1, more
    )


def mimic(joint: str, multiplier: float = 1.0, offset: float = 0.0) -> str:
    return f'<mimic joint="{joint}" multiplier="{multiplier}" offset="{offset}"/>'


def imported(folder: Path, *fingers: str, **options: object) -> tuple[RobotDescription, Report]:
    file = folder / "source.urdf"
    file.write_text(f'<robot name="arm">{"".join((*ARM, *fingers))}</robot>')
    descriptor, report = import_robot(file, folder / "made", Options(name="arm", **options))  # type: ignore[arg-type]
    return load_robot(str(descriptor)), report


LEFT, RIGHT = slide("left", "0 1 0"), slide("right", "0 -1 0", mimic("left_joint"))


def test_fingers_that_mimic_one_another_become_a_gripper(tmp_path: Path) -> None:
    robot, report = imported(tmp_path, LEFT, RIGHT)
    gripper = robot.descriptor.grippers["gripper"]
    assert (gripper.joint, set(gripper.pads)) == ("left_joint", {"left", "right"})
    assert gripper.positions == (0.0, 0.03)
    assert gripper.widths == pytest.approx((0.0, 0.06), abs=5e-4)
    assert (gripper.speed, gripper.force) == (pytest.approx(0.2, rel=0.02), 30.0)
    assert "`left_joint` drives it, followed by `right_joint`; it opens from 0 to 60 mm" in report.markdown()
    model = RobotModel.of(robot)
    for width in (0.06, 0.02):
        at = model.with_attached((), (), (("gripper", width),))
        poses = dict(zip(at.links, at.link_transforms(robot.descriptor.home), strict=True))
        left, right = (np.linalg.inv(poses["link_5"]) @ poses[name] for name in ("left", "right"))
        assert left[1, 3] - right[1, 3] == pytest.approx(0.01 + width, abs=1e-3)


def test_followers_of_followers_follow_the_drive(tmp_path: Path) -> None:
    third = LINK.format("pad", "0.02 0.01 0.02") + JOINT.format(
        "pad_joint", "prismatic", "right", "pad", "0 0 0.01", "0 0 1", 0.0, 0.1, 0.1, mimic("right_joint", 0.5, 0.001)
    )
    robot, _ = imported(tmp_path, LEFT, slide("right", "0 -1 0", mimic("left_joint", 1.0)), third)
    positions = robot.gripper_positions({"gripper": 0.03})
    half = positions["left_joint"]
    assert positions == {
        "left_joint": pytest.approx(0.015, abs=5e-4),
        "right_joint": pytest.approx(half),
        "pad_joint": pytest.approx(0.5 * half + 0.001),
    }


def test_fingers_with_drives_of_their_own_stand_fixed(tmp_path: Path) -> None:
    robot, report = imported(tmp_path, LEFT, slide("right", "0 -1 0"))
    assert robot.descriptor.grippers == {}
    assert "They stand fixed: they have several drives" in report.markdown()


def test_a_gripper_that_was_fixed_stands_there(tmp_path: Path) -> None:
    robot, _ = imported(tmp_path, LEFT, RIGHT, fixed={"left_joint": 0.01})
    assert robot.descriptor.grippers == {}


def test_a_jaw_opens_beside_a_fixed_one(tmp_path: Path) -> None:
    jaw = LINK.format("jaw", "0.02 0.01 0.1").replace(
        "<geometry>", '<origin xyz="0 0 0.05"/><geometry>'
    ) + JOINT.format("jaw_joint", "revolute", "link_5", "jaw", "0 0.036 0.05", "-1 0 0", 0.0, 1.0, 2.0, "")
    robot, _ = imported(tmp_path, jaw, tip="link_5")
    gripper = robot.descriptor.grippers["gripper"]
    assert gripper.positions[0] == pytest.approx(0.0)
    assert gripper.open == pytest.approx(2 * np.sin(0.5) * np.hypot(0.1, np.hypot(0.01, 0.005)), rel=0.02)
