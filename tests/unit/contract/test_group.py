"""Joint groups of a descriptor: their joints and tips, and what is refused with its line."""

from __future__ import annotations

from pathlib import Path

import pytest

from support.composed import torso_with_arms, two_pandas
from zarm_contract.errors import InvalidRequest
from zarm_contract.robot import load_robot


@pytest.fixture
def torso(tmp_path: Path) -> Path:
    return torso_with_arms(tmp_path)


def edit(file: Path, before: str, after: str) -> None:
    text = file.read_text()
    assert before in text
    file.write_text(text.replace(before, after, 1))


def test_a_group_is_the_robot_with_its_joints_alone(torso: Path) -> None:
    robot = load_robot(str(torso))
    arm = robot.group("torso+right")
    names = ("turn", "bend", "elbow", "slide")
    assert arm.descriptor.joints == (*(f"torso_{name}" for name in names), *(f"right_{name}" for name in names))
    assert arm.descriptor.tip_link == "right_rod"
    assert arm.descriptor.home == robot.descriptor.home[:4] + robot.descriptor.home[8:]
    assert arm.lower == robot.lower[:4] + robot.lower[8:]
    assert arm.descriptor.cspace.jerk == robot.descriptor.cspace.jerk[:4] + robot.descriptor.cspace.jerk[8:]
    assert arm.whole is robot


def test_a_group_of_groups_has_the_joints_and_tips_of_all(torso: Path) -> None:
    edit(torso, "groups:\n", "groups:\n  arms: {groups: [right, left]}\n")
    robot = load_robot(str(torso))
    assert robot.group_joints("arms") == robot.descriptor.joints[4:]
    assert robot.tip_of(("arms",)) == "right_rod"
    assert robot.tips == ("torso_rod", "left_rod", "right_rod")


@pytest.mark.parametrize(
    ("before", "after", "fault"),
    [
        ("- torso_turn\n", "", r"cspace.velocity: 12 values for 11 joints"),
        ("- left_turn\n- left_bend\n", "- left_bend\n- left_turn\n", r"left_turn carries left_bend; list it before"),
        ("- left_turn\n", "- left_nose\n", r"left_nose is not a moving joint of the URDF"),
        ("tip_link: torso_rod\n\n", "tip_link: base\n\n", r"tip_link: base is the tip of no group"),
        ("    tip_link: left_rod\n", "    tip_link: nose\n", r"groups.left.tip_link: the link nose is not in the URDF"),
        ("    - left_turn\n", "    - right_turn\n", r"groups.left.joints: right_turn does not move left_rod"),
        ("groups:\n", "groups:\n  arms: {groups: [left, up]}\n", r"groups.arms.groups: there is no group up"),
        ("groups:\n", "groups:\n  arms: {}\n", r"groups.arms.tip_link: give either"),
        ("groups:\n", "groups:\n  Arms: {tip_link: left_rod}\n", r"small letters, digits"),
    ],
)
def test_a_fault_names_the_line_and_the_remedy(torso: Path, before: str, after: str, fault: str) -> None:
    edit(torso, before, after)
    with pytest.raises(InvalidRequest, match=rf"torso_arms.yaml:\d+: .*{fault}"):
        load_robot(str(torso))


def test_a_joint_of_no_group_is_refused(tmp_path: Path) -> None:
    file = two_pandas(tmp_path)
    edit(file, "  right:\n    tip_link: right_panda_grasptarget\n", "")
    with pytest.raises(InvalidRequest, match="no group moves right_panda_joint1; add it to one in `groups`"):
        load_robot(str(file))
