"""All that a URDF says about a robot's joints is taken, or said."""

from __future__ import annotations

from pathlib import Path

import pytest

from zarm_contract.errors import InvalidRequest
from zarm_contract.urdf import Urdf, load_urdf
from zarm_robot_import.chain import choose_chain
from zarm_robot_import.description import Description, describe
from zarm_robot_import.limits import limits_of
from zarm_robot_import.source import read_source


def arm(
    inside: str = "", kind: str = "revolute", limit: str = 'lower="-2.5" upper="2.5" velocity="2"', more: str = ""
) -> str:
    joints = (
        f'<joint name="handler_{i}" type="{kind}"><parent link="hand{i}"/><child link="hand{i + 1}"/>{inside}<limit {limit}/></joint>'
        for i in range(3)
    )
    links = (f'<link name="hand{i}"/>' for i in range(4))
    return f'<robot name="arm">{"".join([*links, *joints])}{more}</robot>'


def both(folder: Path, text: str) -> tuple[Urdf, Description]:
    """As a descriptor and as an import read it."""
    (file := folder / "arm.urdf").write_text(text)
    return load_urdf(file), describe(read_source(file))


def test_joints_are_the_arm_whatever_they_are_called(tmp_path: Path) -> None:
    _, robot = both(tmp_path, arm())
    assert [joint.name for joint in choose_chain(robot).joints] == ["handler_0", "handler_1", "handler_2"]


def test_the_joints_of_the_arm_can_be_chosen(tmp_path: Path) -> None:
    _, robot = both(tmp_path, arm())
    chain = choose_chain(robot, names=["handler_0", "handler_2"])
    assert [joint.name for joint in chain.joints] == ["handler_0", "handler_2"]
    assert dict(chain.fixed) == {"handler_1": 0.0}


def test_a_quaternion_turns_as_its_angles_do(tmp_path: Path) -> None:
    quaternion, _ = both(tmp_path, arm('<origin xyz="1 0 0" quat_xyzw="0 0.707106781187 0 0.707106781187"/>'))
    for joint in quaternion.joint_of_child.values():
        assert joint.rpy == pytest.approx((0.0, 1.5707963267948966, 0.0))


def test_soft_limits_within_the_hard_ones_are_taken_and_said(tmp_path: Path) -> None:
    soft = '<safety_controller soft_lower_limit="-1.5" soft_upper_limit="1.5" k_velocity="1"/>'
    for read in both(tmp_path, arm(soft)):
        assert {(joint.lower, joint.upper) for joint in read.joint_of_child.values()} == {(-1.5, 1.5)}
        assert any("-1.5 to 1.5 are taken" in note for note in read.notes)


def test_limits_of_acceleration_and_jerk_are_taken(tmp_path: Path) -> None:
    _, robot = both(
        tmp_path, arm(limit='lower="-1" upper="1" velocity="2" acceleration="12" deceleration="8" jerk="90"')
    )
    limits = limits_of(robot, choose_chain(robot).joints)
    assert {(limit.acceleration, limit.jerk, limit.assumed) for limit in limits} == {(8.0, 90.0, ())}


def test_only_a_continuous_joint_may_have_infinite_limits(tmp_path: Path) -> None:
    endless = 'lower="-inf" upper="1e308" velocity="2"'
    urdf, _ = both(tmp_path, arm(kind="continuous", limit=endless))
    assert {(joint.lower, joint.upper) for joint in urdf.joint_of_child.values()} == {(None, None)}
    with pytest.raises(InvalidRequest, match='write type="continuous" if it turns freely'):
        both(tmp_path, arm(limit=endless))


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        (arm(limit='lower="-1" uper="1"'), "did you mean upper=?"),
        (arm('<origin xzy="1 0 0"/>'), "did you mean xyz=?"),
        (arm('<axis xyz="0 0 1" rpy="0 0 0"/>'), "<axis> has rpy="),
        (arm("<axis>0 0 1</axis>"), "holds the text '0 0 1'"),
        (arm('<axis xyz="0 0 1"/><axis xyz="0 1 0"/>'), "has 2 <axis>; keep one"),
        (arm('<origin rpy="0 0 0" quat_xyzw="0 0 0 1"/>'), "both rpy= and quat_xyzw=; keep one"),
        (arm(more='<include file="b.urdf"/>'), "which no reader of URDFs follows"),
    ],
)
def test_what_could_change_the_robot_is_refused_by_both_readers(tmp_path: Path, text: str, sentence: str) -> None:
    (file := tmp_path / "arm.urdf").write_text(text)
    for read in (load_urdf, lambda path: describe(read_source(path))):
        with pytest.raises(InvalidRequest) as refused:
            read(file)
        assert sentence in refused.value.problem.message


def test_ineffective_elements_are_reported(tmp_path: Path) -> None:
    more = '<link name="x"/><joint name="f" type="fixed"><parent link="hand3"/><child link="x"/><axis xyz="0 0 0"/></joint>'
    for read in both(tmp_path, arm(more=f'{more}<thing version="3"/><transmission/>')):
        (note,) = read.notes
        assert "<robot> holds <thing>, which no URDF knows" in note


def test_an_argument_that_a_xacro_does_not_have_is_refused(tmp_path: Path) -> None:
    (file := tmp_path / "arm.xacro").write_text(
        '<robot name="arm" xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:arg name="side" default="l"/><link name="$(arg side)"/></robot>'
    )
    with pytest.raises(InvalidRequest, match="has no argument sde; there are side"):
        read_source(file, (), {"sde": "r"})
