"""Where an arm ends that nobody has said the tip of."""

from __future__ import annotations

import itertools
from pathlib import Path

import pytest

from zarm_contract.errors import InvalidRequest
from zarm_robot_import.chain import Chain, choose_chain
from zarm_robot_import.description import describe
from zarm_robot_import.source import read_source

LINK = '<link name="{0}"><collision><geometry><sphere radius="0.05"/></geometry></collision></link>'
JOINT = (
    '<joint name="{0}" type="revolute"><parent link="{1}"/><child link="{2}"/><origin xyz="0 0 0.2"/><axis xyz="0 1 0"/>'
    '<limit lower="-1" upper="1" velocity="1" effort="1"/></joint>'
)
Row = tuple[str, str, str]
ARM: list[Row] = [(f"joint_{k}", f"link_{k}", f"link_{k + 1}") for k in range(5)]


def tip(folder: Path, joints: list[Row]) -> str:
    return chain(folder, joints).tip


def chain(folder: Path, joints: list[Row]) -> Chain:
    links = dict.fromkeys(name for _, *pair in joints for name in pair)
    text = "".join([*map(LINK.format, links), *(JOINT.format(*joint) for joint in joints)])
    file = folder / "arm.urdf"
    file.write_text(f'<robot name="arm">{text}</robot>')
    return choose_chain(describe(read_source(file, ())), None, None)


def finger(name: str, palm: str, count: int) -> list[Row]:
    names = [palm, *(f"{name}_{k}" for k in range(count))]
    return [(f"{child}_joint", parent, child) for parent, child in itertools.pairwise(names)]


@pytest.mark.parametrize(
    ("more", "expected"),
    [
        ([], "link_5"),
        ([("wrist_roll", "link_5", "gripper_link"), ("gripper", "gripper_link", "moving_jaw")], "moving_jaw"),
        ([("gripper", "link_5", "moving_jaw")], "moving_jaw"),
        ([*finger("thumb", "link_5", 4), *finger("index", "link_5", 4)], "link_5"),
    ],
    ids=["the last link", "a turning gripper in a row", "names that mean nothing", "a hand with long fingers"],
)
def test_an_arm_ends_where_what_grips_begins(tmp_path: Path, more: list[Row], expected: str) -> None:
    assert tip(tmp_path, [*ARM, *more]) == expected


@pytest.mark.parametrize("limits", [(-0.17, 1.75), (-1.57, 0.0)])
def test_a_one_sided_last_joint_may_be_a_jaw_and_is_asked(tmp_path: Path, limits: tuple[float, float]) -> None:
    last = JOINT.replace('lower="-1" upper="1"', 'lower="{}" upper="{}"'.format(*limits))
    text = "".join([*(LINK.format(f"link_{k}") for k in range(7)), *(JOINT.format(*row) for row in ARM)])
    file = tmp_path / "arm.urdf"
    file.write_text(f'<robot name="arm">{text}{last.format("anything", "link_5", "link_6")}</robot>')
    robot = describe(read_source(file, ()))
    with pytest.raises(
        InvalidRequest, match=r"anything may be .* --tip link_5 \(a gripper\), --tip link_6 \(of the arm\)"
    ):
        choose_chain(robot)
    assert len(choose_chain(robot, tip="link_6").joints) == 6
    assert choose_chain(robot, tip="link_5").reason == "`--tip` chose them."
    names = [name for name, _, _ in ARM[:4]]
    assert [joint.name for joint in choose_chain(robot, names=names).joints] == names


def test_two_arms_with_hands_are_a_group_each(tmp_path: Path) -> None:
    arms = [(f"{side}_{name}", f"{side}_{parent}", f"{side}_{child}") for side in "lr" for name, parent, child in ARM]
    mounts = [(f"{side}_mount", "torso", f"{side}_link_0") for side in "lr"]
    fingers = [(f"{side}_finger_{k}", f"{side}_link_5", f"{side}_finger_{k}") for side in "lr" for k in range(2)]
    head = [("pan", "torso", "neck"), ("tilt", "neck", "head")]
    tree = chain(tmp_path, [*mounts, *arms, *fingers, *head])
    assert [(group.name, group.tip) for group in tree.groups] == [("l", "l_link_5"), ("r", "r_link_5")]
    assert tree.tips == ("l_link_5", "r_link_5")
    assert [tree.carriers[parent] for parent in tree.parents[:2]] == ["torso", "l_link_0"]
    assert tree.carriers[tree.parents[6]] == "torso"
    assert {name for name, _ in tree.fixed} == {"pan", "tilt", *(name for name, *_ in fingers)}


def test_joints_that_carry_both_arms_are_a_group_too(tmp_path: Path) -> None:
    arms = [
        (f"{side}_{name}", f"{side}_{parent}", f"{side}_{child}")
        for side in ("left", "right")
        for name, parent, child in ARM
    ]
    mounts = [(f"{side}_mount", "chest", f"{side}_link_0") for side in ("left", "right")]
    tree = chain(tmp_path, [("lift", "base", "column"), ("waist", "column", "chest"), *mounts, *arms])
    assert [group.name for group in tree.groups] == ["left", "right", "torso", "torso+left", "torso+right"]
    joints = {group.name: group.joints for group in tree.groups}
    assert joints["torso"] == ("lift", "waist")
    assert joints["torso+left"] == ("lift", "waist", *joints["left"])
    assert [joint.name for joint in tree.joints] == [*joints["torso+left"], *joints["right"]]


def test_arms_whose_names_say_nothing_are_numbered(tmp_path: Path) -> None:
    rows = [
        (f"q{9 * arm + k}", f"link_{arm}_{k}" if k else "base", f"link_{arm}_{k + 1}")
        for arm in (1, 2)
        for k in range(5)
    ]
    assert [group.name for group in chain(tmp_path, rows).groups] == ["arm_1", "arm_2"]


def test_arms_with_too_many_joints_are_offered_one_by_one(tmp_path: Path) -> None:
    arms = [row for number in range(4) for row in finger(f"arm{number}", "base", 9)]
    with pytest.raises(InvalidRequest, match=r"several chains start at base; choose one: --tip arm0_8, --tip arm1_8"):
        chain(tmp_path, arms)
