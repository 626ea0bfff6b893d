"""A descriptor and its URDF make one robot, whose hash is its content, or are refused with what is wrong."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from zarm_contract.errors import InvalidRequest
from zarm_contract.robot import find_robot, load_robot


def replace(file: Path, old: str, new: str) -> None:
    """Break a file in one place."""
    text = file.read_text()
    assert text.count(old) == 1
    file.write_text(text.replace(old, new))


def refusal(descriptor: Path) -> str:
    with pytest.raises(InvalidRequest) as error:
        load_robot(str(descriptor))
    return error.value.problem.message


def test_a_descriptor_and_its_urdf_make_a_robot(pendulum: Path) -> None:
    robot = load_robot(str(pendulum))
    assert robot.descriptor.name == "pendulum"
    assert (robot.lower, robot.upper) == ((-1.5,), (1.5,))
    assert [joint.name for joint in robot.urdf.chain("base", "tip")] == ["swing", "flange"]
    assert robot.urdf_path == pendulum.with_name("pendulum.urdf")


def test_a_continuous_joint_has_no_limits(pendulum: Path) -> None:
    urdf = pendulum.with_name("pendulum.urdf")
    replace(urdf, 'type="revolute"', 'type="continuous"')
    robot = load_robot(str(pendulum))
    assert (robot.lower, robot.upper) == ((-math.inf,), (math.inf,))
    lower, upper = robot.range_about((15.0,))
    assert (*lower, *upper) == pytest.approx((15.0 - math.pi, 15.0 + math.pi), abs=1e-5)


@pytest.mark.parametrize("suffix", [".yaml", ".urdf"])
def test_the_hash_changes_with_every_change_of_the_robot(pendulum: Path, suffix: str) -> None:
    before = load_robot(str(pendulum)).hash
    assert load_robot(str(pendulum)).hash == before
    file = pendulum.with_suffix(suffix)
    file.write_text(file.read_text() + "\n")
    assert load_robot(str(pendulum)).hash != before


def test_numbers_may_be_written_as_yaml_reads_them(pendulum: Path) -> None:
    replace(pendulum, "home: [0.0]", "home: [1e-3]")  # a text, to YAML
    assert load_robot(str(pendulum)).descriptor.home == (0.001,)


# -- faults of the descriptor --


def test_a_link_with_spheres_needs_the_geometry_that_they_cover(pendulum: Path) -> None:
    replace(pendulum, "spheres:\n", "spheres:\n  tip:\n    - {center: [0, 0, 0], radius: 0.05}\n")
    assert "collision: the link tip has spheres but no exact geometry" in refusal(pendulum)


@pytest.mark.parametrize("text", ["[1, 2", "a: b: c", "\tname: x", "name: [\x00]"])
def test_what_is_no_yaml_is_said_with_its_line(pendulum: Path, text: str) -> None:
    pendulum.write_text(text)
    assert refusal(pendulum).startswith(f"{pendulum}")
    assert "not valid YAML" in refusal(pendulum)


@pytest.mark.parametrize("text", ["", "- a\n- b\n", "robot"])
def test_what_is_no_mapping_is_refused(pendulum: Path, text: str) -> None:
    pendulum.write_text(text)
    assert "a robot descriptor is a mapping" in refusal(pendulum)


def test_what_is_no_text_is_refused(pendulum: Path) -> None:
    pendulum.write_bytes(b"\xff\xfe\x00")
    assert "as a robot descriptor: " in refusal(pendulum)


def test_a_missing_file_and_an_unknown_name_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InvalidRequest, match="there is no robot descriptor at"):
        find_robot(str(tmp_path / "mine.yaml"))
    with pytest.raises(InvalidRequest, match="unknown robot 'r2d2': zarm brings"):
        find_robot("r2d2")


# -- faults of the URDF --


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('<link name="tip"/>', "", "joint flange names the link tip, which is not in the file"),
        ('<link name="tip"/>', "<link/>", "a <link> has no name="),
        ('<axis xyz="0 1 0"/>', '<axis xyz="0 0 0"/>', "has the axis 0 0 0"),
        ('<origin xyz="0 0 0.1"/>', '<origin xyz="0 0 nan"/>', "xyz='0 0 nan' must be 3 finite numbers"),
        ('lower="-1.5"', 'lower="inf"', "joint swing (revolute) has the limits inf to 1.5; write type=\"continuous\""),
        ('<parent link="base"/>', "", "joint swing has no <parent>"),
        ('name="flange"', 'name="swing"', "two joints are named swing"),
        ('<child link="tip"/>', '<child link="arm"/>', "the link arm has two parent joints"),
        ('<parent link="base"/>', '<parent link="tip"/>', "no chain of joints from base to tip"),
    ],
)  # fmt: skip
def test_a_fault_of_the_urdf_is_named(pendulum: Path, old: str, new: str, message: str) -> None:
    replace(pendulum.with_name("pendulum.urdf"), old, new)
    assert message in refusal(pendulum)


def test_a_bounded_joint_needs_limits(pendulum: Path) -> None:
    urdf = pendulum.with_name("pendulum.urdf")
    replace(urdf, '<limit lower="-1.5" upper="1.5" velocity="1" effort="1"/>', "")
    assert "joint swing (revolute) needs <limit" in refusal(pendulum)
