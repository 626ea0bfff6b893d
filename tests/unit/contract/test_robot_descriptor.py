"""Whoever edits a robot's files is told what is wrong, in which line, and what to write instead."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import pytest

from support.paths import ROOT
from support.planner.containment import contains
from zarm_contract.errors import InvalidRequest
from zarm_contract.robot import ROBOTS, load_robot


@pytest.fixture
def arm(tmp_path: Path) -> Path:
    """A copy of a real descriptor and its URDF, to be edited."""
    for suffix in (".yaml", ".urdf"):
        shutil.copy(ROBOTS / f"doosan_m1013{suffix}", tmp_path / f"doosan_m1013{suffix}")
    return tmp_path / "doosan_m1013.yaml"


def edit(file: Path, old: str, new: str) -> int:
    """Replace the only place where `old` stands; the line of it."""
    text = file.read_text()
    assert text.count(old) == 1, f"{text.count(old)} places have {old!r}"
    file.write_text(text.replace(old, new))
    return text[: text.index(old)].count("\n") + 1


def faults(descriptor: Path) -> list[str]:
    with pytest.raises(InvalidRequest) as error:
        load_robot(str(descriptor))
    return error.value.problem.message.splitlines()


JOINTS = "joints: [joint_1, joint_2, joint_3, joint_4, joint_5, joint_6]"
HOME = "home: [0.0, 0.0, 1.570796, 0.0, 1.570796, 0.0]"
LINKS = "base_link, link_1, link_2, link_3, link_4, link_5, link_6"
LINK_6 = "    - {kind: sphere, center: [0.0, 0.0, -0.0348], radius: 0.051}"


@pytest.mark.lengthy
@pytest.mark.parametrize(
    ("old", "new", "at", "fault"),
    [
        ("tip_link: link_6", "tip_link: [link_6", "joints:", "not valid YAML: did not find expected ',' or ']'"),
        ("interpolation_dt", "interpolation_time", "", "interpolation_time: Extra inputs are not permitted; did you mean interpolation_dt?"),
        ("strategy: emulator", "colour: white", "", "colour: Extra inputs are not permitted; docs/reference/robot.md lists the keys"),
        ("strategy: emulator", HOME, "", "home: also appears in line {home}; keep one"),
        ("name: doosan_m1013", "name: M1013", "", "name: String should match pattern '^[a-z][a-z0-9_]{0,63}$'; use small letters, digits and _, a letter first"),
        (HOME, "home: [0.0, 0.0, 1.57]", "", "home: 3 values for 6 joints"),
        (HOME, "home: 0.0", "", "home: Input should be a valid tuple; write a list: [0.1, 0.2, 0.3]"),
        (HOME, "home: [0.0, 0.0, 3.1, 0.0, 1.57, 0.0]", "", "home.2: 3.1 is outside the limits of joint_3: -2.7925 to 2.7925"),
        (HOME, "home: [0.0, 0.0, .nan, 0.0, 1.57, 0.0]", "", "home.2: Input should be a finite number"),
        ("  velocity: [1.2, ", "  velocity: [-1.2, ", "", "cspace.velocity.0: Input should be greater than 0"),
        ("tip_link: link_6", "tip_link: flange", "", f"tip_link: the link flange is not in doosan_m1013.urdf; the links there are {LINKS}"),
        ("base_link: base_link\n", "base_link: link_6\n", "joints:", "joints: the moving joints from base_link to tip_link are []; list them in this order"),
        (JOINTS, JOINTS.replace("1, joint_2", "2, joint_1"), "", "joints: the moving joints from base_link to tip_link are ['joint_1', 'joint_2', 'joint_3', 'joint_4', 'joint_5', 'joint_6']; list them in this order"),
        (JOINTS, JOINTS.replace("joint_2", "joint_1"), "", "joints: a name appears twice"),
        ("  link_6: *link_6\n", "", "spheres:", "spheres: the link link_6 has collision geometry but no sphere that covers it"),
        ("  - [link_4, link_6]", "  - [link_4, tool]", "", f"self_collision_ignore.12.1: the link tool is not in doosan_m1013.urdf; the links there are {LINKS}"),
        ("  - [link_4, link_6]", "  - [link_4]", "", "self_collision_ignore.12.1: Field required; docs/reference/robot.md explains what to write here"),
        (LINK_6, LINK_6.replace("sphere", "ball"), "", "collision.link_6.0: Input tag 'ball' found using 'kind' does not match any of the expected tags: 'sphere', 'capsule', 'cylinder', 'cuboid'"),
        (LINK_6, LINK_6.replace("kind: sphere, ", ""), "", "collision.link_6.0: Unable to extract tag using discriminator 'kind'; write kind: sphere, capsule, cylinder or cuboid"),
        ("  state_topic: /leeloo", "  state_topik: /leeloo", "", "strategy_params.state_topik: Extra inputs are not permitted; did you mean state_topic?"),
        ("  command_topic: /leeloo/execute_trajectory\n", "", "strategy_params:", "strategy_params.command_topic: Field required; docs/reference/robot.md explains what to write here"),
        ("  joint_order: [joint_1, joint_2", "  joint_order: [joint_1, joint_1", "", "strategy_params.joint_order: name each of joint_1, joint_2, joint_3, joint_4, joint_5, joint_6 once, in the order of the driver"),
        ("  acceleration: [1.2, ", "  acceleration: [", "", "strategy_params.acceleration: 5 values for 6 joints"),
        ("  point_dt: 0.02", "  point_dt: 0.03", "strategy_params:", "strategy_params.chunk_period: 0.08 s is not a whole number of points; use a multiple of point_dt 0.03 s"),
        ("  point_dt: 0.02", "  gain: 10", "", "strategy_params.gain: the robot would oscillate, because 10/s times delay and chunk_period is more than 1; use at most 7.14"),
        ("  point_dt: 0.02", "  point_dt: 0.004\n  chunk_period: 0.004", "  chunk_period: 0.004", "strategy_params.chunk_period: 0.004 s is not a whole number of periods of the control loop, so that chunks would not be evenly spaced; use a multiple of 0.01 s, or change execution.control_rate"),
        ("interpolation_dt: 0.02", "interpolation_dt: 0.02\nexecution: {control_rate: 130}", "strategy_params:", "strategy_params.chunk_period: 0.08 s is not a whole number of periods of the control loop, so that chunks would not be evenly spaced; use a multiple of 0.00769231 s, or change execution.control_rate"),
        ("  strategies: [joint_speed, ", "  strategies: [joint_force, ", "", "strategy_params.strategies.0: there is no strategy 'joint_force' for drivers; choose among joint_speed, joint_pose, joint_trajectory"),
        ("urdf: doosan_m1013.urdf", "urdf: m1013.urdf", "", "urdf: cannot read the URDF {folder}/m1013.urdf: no such file; the path is relative to the descriptor's folder"),
    ],
)  # fmt: skip
def test_a_fault_of_the_descriptor_has_its_line_and_a_remedy(
    arm: Path, old: str, new: str, at: str, fault: str
) -> None:
    home = arm.read_text().split("\nhome: ")[0].count("\n") + 2
    line = edit(arm, old, new)
    if at:
        (line,) = (number for number, text in enumerate(arm.read_text().splitlines(), 1) if text.startswith(at))
    assert f"{arm}:{line}: {fault.replace('{folder}', str(arm.parent)).replace('{home}', str(home))}" in faults(arm)


def test_with_whole_trajectories_any_control_rate_is_valid(arm: Path) -> None:
    edit(arm, "interpolation_dt: 0.02", "interpolation_dt: 0.02\nexecution: {control_rate: 130}")
    edit(arm, "strategies: [joint_speed, joint_pose, joint_trajectory]", "strategies: [joint_trajectory]")
    assert load_robot(str(arm)).descriptor.execution.control_rate == 130


@pytest.mark.parametrize(
    ("old", "new", "fault"),
    [
        ('  <link name="link_6"/>', '  <link name="link_6">', "not well-formed XML: mismatched tag"),
        ('<origin xyz="0 0 0.1525"', '<mimic joint="joint_2"/><origin xyz="0 0 0.1525"', "joint joint_1 mimics joint_2, which is not the joint of a gripper; name that in `grippers` of the descriptor, or make this one fixed at the position it is used in"),
        ('xyz="0 -0.121 0"', 'xyz="0 -0.121"', "joint joint_6: xyz='0 -0.121' must be 3 finite numbers"),
        ('xyz="0 -0.121 0"', 'xyz="0 ${d6} 0"', "joint joint_6: xyz='0 ${d6} 0' must be 3 finite numbers; this is a xacro file: expand it first with `xacro`"),
        ('lower="-2.7925"', 'lower="2.8"', "joint joint_3 has its lower limit 2.8 above its upper limit 2.7925; swap them"),
        ('lower="-2.7925" upper="2.7925"', "", "joint joint_3 cannot move: both limits are 0.0; give a range or make it fixed"),
        ('name="joint_6" type="revolute"', 'name="joint_6" type="hinge"', "joint joint_6 has the type hinge; known are revolute, continuous, prismatic, fixed, floating, planar"),
        ('<robot name="doosan_m1013">', "<sdf>", "not well-formed XML: mismatched tag"),
    ],
)  # fmt: skip
def test_a_fault_of_the_urdf_has_its_line_and_a_remedy(arm: Path, old: str, new: str, fault: str) -> None:
    urdf = arm.with_suffix(".urdf")
    line = edit(urdf, old, new)
    if "mismatched" in fault:  # noticed where the tags end that do not match
        line = urdf.read_text().count("\n")
    assert faults(arm) == [f"{urdf}:{line}: {fault}"]


def test_a_file_that_is_no_urdf_is_said(arm: Path) -> None:
    urdf = arm.with_suffix(".urdf")
    urdf.write_text("<sdf version='1.7'/>")
    assert faults(arm) == [f"{urdf}:1: a URDF starts with <robot>; this file starts with <sdf>"]


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("strategy: emulator", "strategy: \x07"),
        ("strategy: emulator", "strategy: !!timestamp emulator"),
        ("tip_link: link_6", 'tip_link: "link\\n6"'),
        ("urdf: doosan", 'urdf: "doosan\\n"\n"m\\n1013": doosan'),
        ("spheres:\n", 'spheres:\n  "a: b\\nc": []\n'),
        (HOME, f'{HOME}\n"a\\nb": 1\n"a\\nb": 2'),
    ],
)
def test_each_fault_is_one_line_whatever_it_quotes(arm: Path, old: str, new: str) -> None:
    edit(arm, old, new)
    (fault,) = faults(arm)
    assert fault.startswith(f"{arm}:")


def test_a_robot_without_collision_geometry_is_refused(arm: Path) -> None:
    line = edit(arm, "collision:\n", "collision: {}\nspheres: {}\nself_collision_ignore: []\nrest:\n")
    text = arm.read_text()
    arm.write_text(text[: text.index("rest:\n")])
    (fault,) = faults(arm)
    assert fault.startswith(f"{arm}:{line}: collision: no link has geometry")


def test_several_faults_of_a_descriptor_are_reported_together(arm: Path) -> None:
    lines = [
        edit(arm, "  velocity: [1.2, ", "  velocity: [fast, "),
        edit(arm, "strategy: emulator", "stratgey: emulator"),
        edit(arm, "name: doosan_m1013", "name: 3"),
    ]
    assert sorted(int(fault.removeprefix(f"{arm}:").split(":")[0]) for fault in faults(arm)) == sorted(lines)


def test_wrong_counts_are_reported_together(arm: Path) -> None:
    edit(arm, JOINTS, JOINTS.replace(", joint_6", ""))
    said = [re.sub(r"^.*?:\d+: ", "", fault) for fault in faults(arm)]
    keys = ("home", "cspace.velocity", "cspace.acceleration", "cspace.jerk", "strategy_params.acceleration")
    assert [fault for fault in said if " values " in fault] == [f"{key}: 6 values for 5 joints" for key in keys]


def test_several_faults_of_a_urdf_are_reported_together(arm: Path) -> None:
    urdf = arm.with_suffix(".urdf")
    lines = [
        edit(urdf, 'name="joint_2" type="revolute"', 'name="joint_2" type="screw"'),
        edit(urdf, 'xyz="0.62 0 0"', 'xyz="620 mm"'),
    ]
    assert [fault.split(": ")[0] for fault in faults(arm)] == [f"{urdf}:{line}" for line in lines]


def test_geometry_that_the_joints_do_not_carry_is_refused(arm: Path) -> None:
    urdf = arm.with_suffix(".urdf")
    edit(
        urdf,
        "</robot>",
        '<link name="finger"/><joint name="slide" type="prismatic"><parent link="link_6"/><child link="finger"/>'
        '<limit lower="0" upper="0.04"/></joint></robot>',
    )
    edit(arm, "  link_6: &link_6\n", "  finger: &finger\n" + LINK_6 + "\n  link_6: &link_6\n")
    edit(arm, "  link_6: *link_6", "  finger: *finger\n  link_6: *link_6")
    (fault,) = faults(arm)
    assert fault.endswith(
        'collision.finger: it hangs on slide, which is not a joint of the robot; describe its gripper in `grippers`, or give that joint type="fixed" in the URDF'
    )
    edit(urdf, 'name="slide" type="prismatic"', 'name="slide" type="fixed"')
    assert "finger" in load_robot(str(arm)).descriptor.collision


def test_a_descriptor_may_refer_to_what_it_wrote_before(arm: Path) -> None:
    descriptor = load_robot(str(arm)).descriptor
    covers = [(one.center, one.radius) for one in descriptor.spheres["link_6"]]
    assert covers == [(one.center, one.radius) for one in descriptor.collision["link_6"] if one.kind == "sphere"]


def test_a_list_that_contains_itself_is_refused(arm: Path) -> None:
    line = edit(arm, HOME, "home: &home [0.0, *home]")
    assert all(fault.startswith(f"{arm}:{line}: home") for fault in faults(arm))


# -- the documentation --


def test_the_readme_lists_every_robot() -> None:
    listed = re.findall(r"^\| `(\w+)`", (ROBOTS / "README.md").read_text(), re.MULTILINE)
    assert sorted(listed) == sorted(file.stem for file in ROBOTS.glob("*.yaml"))


def example(fence: str) -> str:
    page = ROOT / "docs" / "how-to" / "add-a-robot.md"
    (block,) = re.findall(rf"```{fence}\n(.*?)```", page.read_text(), re.DOTALL)
    return str(block)


def test_the_example_of_the_documentation_is_a_robot(tmp_path: Path) -> None:
    (tmp_path / "my_arm.yaml").write_text(example("yaml"))
    (tmp_path / "my_arm.urdf").write_text(example("xml"))
    descriptor = load_robot(str(tmp_path / "my_arm.yaml")).descriptor
    for link, primitives in descriptor.collision.items():
        assert all(contains(descriptor.spheres[link], primitive) for primitive in primitives), link
