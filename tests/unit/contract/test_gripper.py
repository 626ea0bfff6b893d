"""A gripper of a descriptor: its widths, its joints, and what is refused."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from zarm_contract.errors import InvalidRequest
from zarm_contract.gripper import Gripper
from zarm_contract.robot import ROBOTS, load_robot

CLAW = Gripper(joint="knuckle", positions=(0.8, 0.5, 0.0), widths=(0.0, 0.04, 0.085), pads=("pad",))


@pytest.fixture
def panda(tmp_path: Path) -> Path:
    for suffix in (".yaml", ".urdf"):
        shutil.copy(ROBOTS / f"panda{suffix}", tmp_path)
    return tmp_path / "panda.yaml"


def edit(file: Path, before: str, after: str) -> None:
    text = file.read_text()
    assert before in text
    file.write_text(text.replace(before, after))


@pytest.mark.parametrize(("width", "position"), [(0.0, 0.8), (0.02, 0.65), (0.04, 0.5), (0.0625, 0.25), (0.085, 0.0)])
def test_width_and_position_are_linear_between_the_given_ones(width: float, position: float) -> None:
    assert CLAW.position(width) == pytest.approx(position)
    assert CLAW.width(position) == pytest.approx(width)


def test_positions_outside_of_the_range_count_as_its_ends() -> None:
    assert CLAW.width(0.9) == CLAW.closed == 0.0
    assert CLAW.width(-0.1) == CLAW.open == 0.085


def test_joints_that_mimic_the_driven_one_move_with_it() -> None:
    robot = load_robot("panda")
    assert robot.gripper_positions({"hand": 0.03}) == {"panda_finger_joint1": 0.015, "panda_finger_joint2": 0.015}
    assert robot.gripper_positions({}) == {"panda_finger_joint1": 0.04, "panda_finger_joint2": 0.04}


@pytest.mark.parametrize(
    ("before", "after", "fault"),
    [
        ("joint: panda_finger_joint1", "joint: finger", "grippers.hand.joint: the joint finger is not in the URDF"),
        ("joint: panda_finger_joint1", "joint: panda_joint7", "panda_joint7 is a joint of the arm"),
        ("joint: panda_finger_joint1", "joint: panda_hand_joint", "panda_hand_joint is fixed"),
        (
            "positions: [0.0, 0.04]",
            "positions: [0.0, 0.05]",
            "0.05 is outside the limits of panda_finger_joint1: 0.0 to 0.04",
        ),
        ("positions: [0.0, 0.04]", "positions: [0.0, 0.02, 0.04]", "2 values for 3 positions"),
        ("positions: [0.0, 0.04]", "positions: [0.04, 0.04]", "they must all increase or all decrease"),
        ("widths: [0.0, 0.08]", "widths: [0.08, 0.0]", "they must increase, from closed to open"),
        ("pads: [panda_leftfinger,", "pads: [thumb,", "the link thumb is not in the URDF"),
        ("  hand:\n", "  Hand:\n", "grippers.Hand"),
        ("speed: 0.1", "speeed: 0.1", "did you mean speed?"),
    ],
)
def test_what_does_not_fit_is_refused_with_its_line(panda: Path, before: str, after: str, fault: str) -> None:
    edit(panda, before, after)
    if "joint:" in before:
        edit(panda.with_suffix(".urdf"), '<mimic joint="panda_finger_joint1"/>', "")
    with pytest.raises(InvalidRequest) as refused:
        load_robot(str(panda))
    assert fault in str(refused.value)
    assert "panda.yaml:" in str(refused.value)


def test_a_joint_that_mimics_no_gripper_is_refused(panda: Path) -> None:
    edit(panda.with_suffix(".urdf"), '<mimic joint="panda_finger_joint1"/>', '<mimic joint="panda_joint1"/>')
    with pytest.raises(
        InvalidRequest, match="panda_finger_joint2 mimics panda_joint1, which is not the joint of a gripper"
    ):
        load_robot(str(panda))
