"""What is wrong with a URDF is said in one sentence, with file and line."""

from __future__ import annotations

import math
from collections.abc import Iterable
from pathlib import Path

import pytest

from zarm_contract.errors import InvalidRequest
from zarm_robot_import.chain import Chain, choose_chain
from zarm_robot_import.description import describe
from zarm_robot_import.limits import limits_of
from zarm_robot_import.meshes import link_surface
from zarm_robot_import.source import fingerprint, read_source

LIMIT = '<limit lower="-1" upper="1" velocity="1" effort="1"/>'


def joint(name: str, parent: str, child: str, kind: str = "revolute", inside: str = LIMIT) -> str:
    return f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>{inside}</joint>'


def urdf(*joints: str, links: Iterable[str] = "abcd", geometry: str = "") -> str:
    return "\n".join(
        ['<robot name="Arm é">', *(f'<link name="{link}">{geometry}</link>' for link in links), *joints, "</robot>"]
    )


THREE = (joint("one", "a", "b"), joint("two", "b", "c"), joint("three", "c", "d"))


def imported(folder: Path, text: str, **options: str) -> Chain:
    file = folder / "arm.urdf"
    file.write_text(text)
    robot = describe(read_source(file))
    chain = choose_chain(robot, **options)
    limits_of(robot, chain.joints)
    for link in robot.links.values():
        link_surface(robot.source, link)
    return chain


@pytest.mark.parametrize(
    ("text", "line", "sentence"),
    [
        ("<robot>\n<link", 2, "not well-formed"),
        ("<sdf/>", 1, "a URDF starts with <robot>"),
        (urdf(*THREE, joint("three", "c", "d")), 9, "two joints are named three"),
        (urdf(*THREE, joint("four", "b", "d")), 9, "two parent joints"),
        (urdf(joint("one", "a", "b"), joint("two", "c", "d"), joint("back", "d", "c")), 8, "back, two close a loop"),
        (urdf(*THREE[:2], joint("three", "c", "d", "floating")), 8, "is floating, which an arm's joint cannot be"),
        (
            urdf(
                *THREE,
                joint("left", "d", "e", "prismatic", LIMIT + '<mimic joint="right"/>'),
                joint("right", "d", "f", "prismatic", LIMIT + '<mimic joint="left"/>'),
                links="abcdef",
            ),
            11,
            "joint left mimics itself, by way of left and right",
        ),
        (
            urdf(*THREE, geometry='<visual><geometry><mesh filename="meshes/a.stl"/></geometry></visual>'),
            2,
            "there is no file meshes/a.stl; correct the path",
        ),
        (urdf(*THREE, geometry='<visual><geometry><box size="1 -1 1"/></geometry></visual>'), 2, "a negative size"),
        (urdf(*THREE, geometry="<visual><geometry><sphere/></geometry></visual>"), 2, "its <sphere> has no radius="),
        (urdf(*THREE, links="abc"), 7, "names the link d"),
        (urdf(*THREE, links="abcdd"), 6, "two links are named d"),
        (urdf(joint("one", "a", "b", inside='<limit lower="1" upper="-1"/>'), links="ab"), 4, "above its upper limit"),
        (urdf(joint("one", "a", "b", inside='<axis xyz="0 0 0"/>'), links="ab"), 4, "axis 0 0 0"),
        (
            urdf(joint("one", "a", "b", inside='<axis xyz="0 1e-10 0"/>'), links="ab"),
            4,
            "has the axis 0 1e-10 0; give",
        ),
        (urdf(joint("one", "a", "b", inside='<origin xyz="0 0 300"/>'), links="ab"), 4, "300 m from a, so it is in mm"),
        (urdf(joint("one", "a", "b", inside='<limit lower="1" upper="1"/>'), links="ab"), 4, "both its limits at 1"),
        (
            urdf(joint("one", "a", "b", inside='<limit lower="-1" upper="1" velocity="-1"/>'), links="ab"),
            4,
            "a limit of -1 for its velocity; write it positive",
        ),
        (
            urdf(joint("one", "a", "b", inside='<limit lower="-1" upper="1" effort="-5"/>'), links="ab"),
            4,
            "a limit of -5 for its effort; write it positive",
        ),
        (
            urdf(joint("one", "a", "b", "planar"), joint("two", "b", "c"), joint("three", "c", "d", "planar")),
            8,
            "is planar",
        ),
        (
            urdf(*THREE[:2], joint("three", "c", "d", inside=LIMIT + '<mimic joint="one"/>')),
            8,
            "end the chain before it: --tip c",
        ),
        (
            urdf(
                *THREE, geometry='<collision><geometry><mesh filename="package://none/a.stl"/></geometry></collision>'
            ),
            2,
            "there is no file package://none/a.stl",
        ),
        (
            urdf(*THREE, geometry='<visual><geometry><box size="500 200 200"/></geometry></visual>'),
            2,
            "are in mm",
        ),
        (
            urdf(*THREE, geometry='<visual><geometry><box size="1 1"/></geometry></visual>'),
            2,
            "must be 3 finite numbers",
        ),
        (
            urdf(*THREE, geometry='<visual><geometry><mesh filename="https://arm.org/a.stl"/></geometry></visual>'),
            2,
            "zarm fetches nothing: download it",
        ),
        (
            urdf(
                *THREE,
                geometry='<visual><origin xyz="150 0 0"/><geometry><box size="1 1 1"/></geometry></visual>',
            ),
            2,
            "divide the xyz of its <origin> by 1000",
        ),
        (urdf(*THREE, links=["a", "b", "c", "d", "e" * 201]), 6, "has 201 characters, more than 200; shorten it"),
    ],
)
def test_what_is_wrong_is_said_with_file_and_line(tmp_path: Path, text: str, line: int, sentence: str) -> None:
    with pytest.raises(InvalidRequest) as refused:
        imported(tmp_path, text, tip="d" if 'name="d"' in text else "b")
    message = refused.value.problem.message
    assert sentence in message
    assert message.startswith(f"{tmp_path / 'arm.urdf'}:{line}:")
    assert "\n" not in message


def test_a_broken_mesh_is_named(tmp_path: Path) -> None:
    (tmp_path / "a.stl").write_bytes(b"no mesh")
    text = urdf(*THREE, geometry='<visual><geometry><mesh filename="a.stl"/></geometry></visual>')
    with pytest.raises(InvalidRequest, match=r"arm\.urdf:2: link a: .*a\.stl"):
        imported(tmp_path, text)


def test_fingers_are_no_joints_of_the_arm_and_stand_still(tmp_path: Path) -> None:
    left, right = (
        joint("left", "c", "d", "prismatic"),
        joint("right", "c", "e", "prismatic", LIMIT + '<mimic joint="left"/>'),
    )
    chain = imported(tmp_path, urdf(*THREE[:2], left, right, links="abcde"))
    assert [one.name for one in chain.joints] == ["one", "two"]
    assert dict(chain.fixed) == {"left": 0.0, "right": 0.0}


def test_a_mimic_that_leads_nowhere_or_to_the_arm_is_named(tmp_path: Path) -> None:
    lost, gear, bolt = (
        joint(name, "d", child, inside=LIMIT + f'<mimic joint="{master}" offset="0.1"/>')
        for name, child, master in (("lost", "e", "nobody"), ("gear", "f", "one"), ("finger", "g", "bolted"))
    )
    text = urdf(*THREE, lost, gear, bolt, joint("bolted", "d", "h", "fixed"), links="abcdefgh")
    chain = imported(tmp_path, text, tip="d")
    first, second = chain.mimics
    assert first.startswith("lost: it mimics nobody, which is not in the file; correct <mimic>; here it stands at 0")
    assert second.startswith("gear: it mimics one, which moves with the arm")
    assert dict(chain.fixed) == {"lost": 0.0, "gear": 0.0, "finger": 0.1}


def test_a_continuous_joint_is_imported_without_limits(tmp_path: Path) -> None:
    file = tmp_path / "arm.urdf"
    file.write_text(urdf(joint("one", "a", "b", "continuous"), links="ab"))
    robot = describe(read_source(file))
    (limits,) = limits_of(robot, choose_chain(robot).joints)
    assert (limits.lower, limits.upper) == (-math.inf, math.inf)


@pytest.mark.parametrize("limit", [1e6, 1e300])
def test_a_range_so_wide_that_it_means_none_is_assumed(tmp_path: Path, limit: float) -> None:
    file = tmp_path / "arm.urdf"
    file.write_text(urdf(joint("one", "a", "b", inside=f'<limit lower="-{limit}" upper="{limit}"/>'), links="ab"))
    robot = describe(read_source(file))
    (limits,) = limits_of(robot, choose_chain(robot).joints)
    assert (limits.lower, limits.upper) == pytest.approx((-2 * math.pi, 2 * math.pi))
    assert "range" in limits.assumed


def test_a_low_velocity_is_kept(tmp_path: Path) -> None:
    file = tmp_path / "arm.urdf"
    file.write_text(urdf(joint("one", "a", "b", inside='<limit lower="-1" upper="1" velocity="1e-5"/>'), links="ab"))
    robot = describe(read_source(file))
    (limits,) = limits_of(robot, choose_chain(robot).joints)
    assert limits.velocity == pytest.approx(1e-5)
    assert limits.jerk > 0.0


def test_of_several_arms_one_may_be_chosen(tmp_path: Path) -> None:
    arms = [joint(f"{side}{i}", "a" if i == 0 else f"{side}{i - 1}", f"{side}{i}") for side in "lr" for i in range(5)]
    links = "".join(f'<link name="{side}{i}"/>' for side in "lr" for i in range(5))
    text = f'<robot name="two"><link name="a"/>{links}{"".join(arms)}</robot>'
    assert [(group.name, group.tip) for group in imported(tmp_path, text).groups] == [("l", "l4"), ("r", "r4")]
    assert [one.name for one in imported(tmp_path, text, tip="r4").joints] == [f"r{i}" for i in range(5)]


def test_where_no_joint_moves_that_is_said_with_its_line(tmp_path: Path) -> None:
    with pytest.raises(InvalidRequest, match=r"arm\.urdf:2: no joint behind a moves"):
        imported(tmp_path, urdf(joint("one", "a", "b", "fixed"), links="ab"))


def test_a_joint_without_limits_gets_assumed_ones(tmp_path: Path) -> None:
    file = tmp_path / "arm.urdf"
    file.write_text(urdf(joint("one", "a", "b", inside=""), links="ab"))
    robot = describe(read_source(file))
    (limits,) = limits_of(robot, choose_chain(robot).joints)
    assert limits.assumed == ("range", "velocity", "acceleration", "jerk")


def test_a_xacro_is_expanded_with_the_packages_around_it(tmp_path: Path) -> None:
    package = tmp_path / "arms" / "arm_description"
    (package / "urdf").mkdir(parents=True)
    (package / "package.xml").write_text("<package><name>my_arm</name></package>")
    (package / "urdf" / "part.xacro").write_text(
        f'<robot xmlns:xacro="http://www.ros.org/wiki/xacro">{joint("one", "a", "b")}</robot>'
    )
    file = package / "urdf" / "arm.xacro"
    file.write_text(
        '<robot name="arm" xmlns:xacro="http://www.ros.org/wiki/xacro"><link name="a"/><link name="b"/>'
        '<xacro:include filename="$(find my_arm)/urdf/part.xacro"/></robot>'
    )
    assert [one.name for one in choose_chain(describe(read_source(file))).joints] == ["one"]


def test_a_failing_xacro_leaves_the_next_one_unharmed(tmp_path: Path) -> None:
    """Also one whose package has no package.xml, and is found by the name of its folder."""
    folder = tmp_path / "kr_arm" / "urdf"
    folder.mkdir(parents=True)
    start, end = '<robot name="arm" xmlns:xacro="http://www.ros.org/wiki/xacro">', "</robot>"
    (folder / "part.xacro").write_text(f'{start}<xacro:include filename="$(find none)/b.xacro"/>{end}')
    include = '<xacro:include filename="$(find kr_arm_support)/urdf/{}.xacro"/>'
    (folder / "bad.xacro").write_text(f"{start}{include.format('part')}{end}")
    (folder / "good.xacro").write_text(f'{start}<link name="a"/>{include.format("beside")}{end}')
    (folder / "beside.xacro").write_text(f'{start}<xacro:include filename="joint.xacro"/>{end}')
    (folder / "joint.xacro").write_text(f'{start}<link name="b"/>{end}')
    with pytest.raises(InvalidRequest, match="there is no package none"):
        read_source(folder / "bad.xacro")
    assert [link.get("name") for link in read_source(folder / "good.xacro").root.findall("link")] == ["a", "b"]


def test_a_xacro_takes_arguments_and_says_which_it_lacks(tmp_path: Path) -> None:
    file = tmp_path / "arm.xacro"
    file.write_text(
        '<robot name="arm" xmlns:xacro="http://www.ros.org/wiki/xacro"><link name="a"/><link name="b"/>'
        f"{joint('$(arg side)_one', 'a', 'b')}</robot>"
    )
    with pytest.raises(InvalidRequest, match="give its value with --arg side:=VALUE"):
        read_source(file)
    assert [one.name for one in choose_chain(describe(read_source(file, (), {"side": "left"}))).joints] == ["left_one"]


def test_the_fingerprint_changes_with_the_robot_and_nothing_else(tmp_path: Path) -> None:
    mesh, part, file = tmp_path / "meshes" / "a.stl", tmp_path / "urdf" / "part.xacro", tmp_path / "urdf" / "arm.xacro"
    mesh.parent.mkdir()
    part.parent.mkdir()
    start, end = '<robot name="arm" xmlns:xacro="http://www.ros.org/wiki/xacro">', "</robot>"
    file.write_text(f'{start}<link name="a"/><xacro:include filename="part.xacro"/>{end}')
    geometry = '<visual><geometry><mesh filename="package://arm/meshes/a.stl"/></geometry></visual>'
    part.write_text(f'{start}<link name="b">{geometry}</link>{joint("one", "a", "b")}{end}')
    mesh.write_text("solid a")
    before = fingerprint(file)
    (tmp_path / "meshes" / "other.stl").write_text("solid other")
    assert fingerprint(file) == before
    mesh.write_text("solid another")
    changed = fingerprint(file)
    assert changed != before
    part.write_text(part.read_text().replace('upper="1"', 'upper="2"'))
    assert fingerprint(file) != changed
