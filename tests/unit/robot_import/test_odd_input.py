"""What other tools stumble over is imported as well as it can be, and what was made of it is said."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from support.tiers import sampled
from zarm_contract.errors import InvalidRequest
from zarm_contract.robot import load_robot
from zarm_geometry.packed_shapes import distances
from zarm_robot_import.body import Body
from zarm_robot_import.chain import choose_chain
from zarm_robot_import.decomposition import fit_primitives
from zarm_robot_import.description import describe
from zarm_robot_import.importing import Options, import_robot
from zarm_robot_import.inertia import unphysical
from zarm_robot_import.meshes import MOST_KEPT, Surface, link_surface
from zarm_robot_import.primitives import packed_shapes_of
from zarm_robot_import.source import read_source
from zarm_robot_import.surface_distance import sticks_out
from zarm_robot_import.triangles import gathered

BOX = trimesh.creation.box((0.1, 0.2, 0.3)).subdivide().subdivide()


def surface(folder: Path, mesh: trimesh.Trimesh | bytes) -> Surface:
    """Of a link with this mesh."""
    if isinstance(mesh, bytes):
        (folder / "a.stl").write_bytes(mesh)
    else:
        mesh.export(folder / "a.stl")
    text = (
        '<robot name="r">\n<link name="a"><visual><geometry><mesh filename="a.stl"/></geometry></visual></link></robot>'
    )
    (folder / "a.urdf").write_text(text)
    robot = describe(read_source(folder / "a.urdf"))
    found = link_surface(robot.source, robot.links["a"])
    assert found
    return found


def inside_out() -> trimesh.Trimesh:
    mesh = BOX.copy()
    mesh.invert()
    return mesh


def open_and_torn() -> trimesh.Trimesh:
    """One triangle is not there, and one stands on an edge that has two already."""
    a, b = BOX.faces[1, :2]
    vertices = np.concatenate([BOX.vertices, [[0.0, 0.0, 0.0]]])
    return trimesh.Trimesh(vertices, np.concatenate([BOX.faces[1:], [[a, b, len(BOX.vertices)]]]), process=False)


@pytest.mark.lengthy
@pytest.mark.parametrize("mesh", [inside_out(), open_and_torn()], ids=["inside-out", "open, non-manifold"])
def test_a_broken_surface_is_contained_as_tightly_as_a_sound_one(tmp_path: Path, mesh: trimesh.Trimesh) -> None:
    found = surface(tmp_path, mesh)
    (box,) = fit_primitives(Body.of(found.triangles, off=found.off))
    assert box.kind == "cuboid"
    assert sorted(box.size) == pytest.approx([0.1, 0.2, 0.3], abs=1e-3)


@pytest.mark.slow
@pytest.mark.lengthy
def test_a_simplified_mesh_contains_the_original(tmp_path: Path) -> None:
    ball = trimesh.creation.icosphere(7, 0.1)
    given = np.asarray(ball.triangles)
    assert len(given) > MOST_KEPT
    found = surface(tmp_path, ball)
    assert len(found.triangles) <= MOST_KEPT
    assert f"its {len(given)} triangles are taken as" in found.warnings[0]
    rows = packed_shapes_of(fit_primitives(Body.of(found.triangles, off=found.off)))
    assert distances(given.reshape(-1, 3)[::7], rows).min(axis=1).max() <= 0.0


def test_gathered_triangles_lose_no_part_however_small() -> None:
    crumbs = np.random.default_rng(0).uniform(-0.1, 0.1, (300, 1, 3)) + 1e-6 * np.eye(3)
    kept, off = gathered(crumbs, 299)
    apart = np.linalg.norm(crumbs[:, None, 0] - kept[None, :, 0], axis=2).min(axis=1)
    assert apart.max() <= off


def test_what_sticks_out_is_found_beside_what_lies_deep_inside() -> None:
    outer = np.asarray(trimesh.creation.box((0.1, 0.1, 0.1)).triangles)
    motor = trimesh.creation.box((0.02, 0.02, 0.02))
    knob = trimesh.creation.box((0.01, 0.01, 0.02))
    knob.apply_translation((0.0, 0.0, 0.06))
    inner = np.concatenate([np.asarray(mesh.triangles) for mesh in [motor] * 5 + [knob]])
    assert sticks_out(inner, outer, 0.001) == pytest.approx(0.02, abs=0.002)
    assert sticks_out(np.asarray(motor.triangles), outer, 0.001) == 0.0


@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        (b"version https://git-lfs.github.com/spec/v1\noid sha256:0\n", "pointer of Git LFS; run `git lfs pull`"),
        (b"", "holds no triangles"),
        (b"solid a\nendsolid a\n", "holds no triangles"),
    ],
    ids=["git lfs", "empty", "no triangles"],
)
def test_a_file_that_is_no_mesh_is_said_with_its_place(tmp_path: Path, content: bytes, sentence: str) -> None:
    with pytest.raises(InvalidRequest, match=r"a\.urdf:2: link a: .*a\.stl") as refused:
        surface(tmp_path, content)
    assert sentence in refused.value.problem.message
    assert "\n" not in refused.value.problem.message


def test_a_mesh_without_valid_numbers_is_refused(tmp_path: Path) -> None:
    nothing = np.full((3, 3), np.nan)
    with pytest.raises(InvalidRequest, match="has only NaN or infinite coordinates; export it again"):
        surface(tmp_path, trimesh.Trimesh(nothing, [[0, 1, 2]], process=False))
    (tmp_path / "some").mkdir()
    corners = np.concatenate([BOX.vertices, nothing])
    faces = np.concatenate([BOX.faces, [np.arange(3) + len(BOX.vertices)]])
    found = surface(tmp_path / "some", trimesh.Trimesh(corners, faces, process=False))
    assert len(found.triangles) == len(BOX.faces)
    assert found.warnings[0].startswith("1 triangles of its visual geometry have NaN or infinite coordinates")


def two_joints(limit: str = 'lower="-2" upper="2" velocity="1"', more: str = "") -> str:
    """An arm of boxes."""
    shape = '<collision><origin xyz="0 0 0.15"/><geometry><box size="0.05 0.05 0.2"/></geometry></collision>'
    links = [f'<link name="l{i}">{shape}</link>' for i in range(3)]
    joints = [
        f'<joint name="j{i}" type="revolute"><parent link="l{i}"/><child link="l{i + 1}"/><origin xyz="0 0 0.3"/>'
        f'<axis xyz="0 1 0"/><limit {limit}/></joint>'
        for i in range(2)
    ]
    return f'<robot name="arm">{"".join(links + joints)}{more}</robot>'


def weighed(mass: str, inertia: str) -> str:
    """One more link, with the six numbers of its inertia."""
    keys = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
    numbers = " ".join(f'{key}="{number}"' for key, number in zip(keys, inertia.split(), strict=True))
    return (
        f'<link name="lump"><inertial><mass value="{mass}"/><inertia {numbers}/></inertial></link>'
        '<joint name="weld" type="fixed"><parent link="l2"/><child link="lump"/></joint>'
    )


FINGER = (
    '<link name="finger"/><joint name="slide" type="prismatic"><parent link="l2"/><child link="finger"/>'
    '<limit lower="0" upper="0.04" velocity="1"/></joint>'
)
XACRO = '<robot name="arm" xmlns:xacro="http://www.ros.org/wiki/xacro">{}</robot>'


@pytest.mark.parametrize(
    ("content", "options", "sentence"),
    [
        (b" \n", {}, "is empty; name a URDF or xacro"),
        (b"hello", {}, "is no XML; name a URDF or xacro"),
        (b"\x89PNG\r\n", {}, "is no XML; name a URDF or xacro"),
        (b'<?xml version="1.0" encoding="klingon"?><robot/>', {}, "save the file as UTF-8"),
        (XACRO.format('<link name="${size}"/>'), {}, "name 'size' is not defined when evaluating"),
        (XACRO.format('<xacro:include filename="none.xacro"/>'), {}, "none.xacro"),
        (two_joints(), {"packages": [Path("/none")]}, "there is no folder /none; name one that holds ROS packages"),
        (
            two_joints(),
            {"base": "l2", "tip": "l1"},
            "no chain of joints leads from the base l2 to the tip l1; swap them",
        ),
        (two_joints(more=weighed("-1", "1 0 0 1 0 1")), {}, "link lump has a mass of -1 kg; write a positive one"),
        (two_joints(more=weighed("1", "1 0 0 nan 0 1")), {}, "link lump: iyy='nan' must be a finite number"),
        (two_joints(more=FINGER), {"tip": "l2", "fixed": {"slide": 4.0}}, "outside of the joint's limits, 0 to 0.04"),
        (
            two_joints(more=FINGER),
            {"tip": "l2", "fixed": {"slide": math.nan}},
            "outside of the joint's limits, 0 to 0.04",
        ),
    ],
)
def test_a_failed_import_says_why_and_leaves_nothing(
    tmp_path: Path, content: bytes | str, options: dict[str, Any], sentence: str
) -> None:
    file = tmp_path / "arm.urdf"
    file.write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(InvalidRequest) as refused:
        import_robot(file, tmp_path / "out", Options(**options))
    assert sentence in refused.value.problem.message
    assert "\n" not in refused.value.problem.message
    assert list(tmp_path.iterdir()) == [file]


def test_a_descriptor_that_is_there_is_not_replaced_unasked(tmp_path: Path) -> None:
    file, there = tmp_path / "a.urdf", tmp_path / "out" / "arm.yaml"
    file.write_text(two_joints())
    there.parent.mkdir()
    there.write_text("corrected by hand")
    with pytest.raises(InvalidRequest, match=r"arm\.yaml exists already.*--overwrite"):
        import_robot(file, there.parent, Options())
    assert there.read_text() == "corrected by hand"
    assert list(there.parent.iterdir()) == [there]


def test_an_unwritable_folder_is_reported_before_computing(tmp_path: Path) -> None:
    (file := tmp_path / "a.urdf").write_text(two_joints())
    with pytest.raises(InvalidRequest, match=r"cannot write into .*; name another folder with --output"):
        import_robot(file, file / "out", Options(), pytest.fail)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("text", "warning"),
    [
        (two_joints('lower="90" upper="180" velocity="1"'), "is most likely in degrees"),
        (two_joints('lower="0" upper="1e-6" velocity="1"'), "lets it hardly move"),
        (
            two_joints(more='<link name="stray"><visual><geometry><sphere radius="1"/></geometry></visual></link>'),
            "stray: no joint connects it to the robot",
        ),
        (two_joints(more=weighed("1", "3 0 0 1 0 1")), "lump: no body has the inertia that its <inertial> states"),
    ],
    ids=["far from 0", "hardly any range", "stray link", "impossible inertia"],
)
def test_an_odd_arm_is_imported_with_a_warning(tmp_path: Path, text: str, warning: str) -> None:
    (file := tmp_path / "a.urdf").write_text(text)
    descriptor, report = import_robot(file, tmp_path / "out", Options())
    robot = load_robot(str(descriptor))
    assert np.all((robot.lower <= robot.descriptor.home) & (robot.descriptor.home <= robot.upper))
    assert any(warning in found for found in report.warnings)
    assert len(list(tmp_path.iterdir())) == 2


@pytest.mark.lengthy
@pytest.mark.parametrize("count", sampled(3, 12))
def test_joints_without_limits_on_a_floating_base_are_imported(tmp_path: Path, count: int) -> None:
    shape = '<collision><origin xyz="0 0 0.1"/><geometry><cylinder radius="0.02" length="0.15"/></geometry></collision>'
    nothing = '<visual><geometry><box size="0 0 0"/></geometry></visual>'
    links = ['<link name="world"/>', *(f'<link name="glied ü{i}">{shape}</link>' for i in range(count + 1))]
    links.append(f'<link name="tip: 手">{nothing}</link>')
    joints = [
        '<joint name="float" type="floating"><parent link="world"/><child link="glied ü0"/></joint>',
        *(
            f'<joint name="ось {i}" type="revolute"><parent link="glied ü{i}"/><child link="glied ü{i + 1}"/>'
            f'<origin xyz="0 0 0.2"/><axis xyz="{i % 2} {1 - i % 2} 0"/></joint>'
            for i in range(count)
        ),
        f'<joint name="end" type="fixed"><parent link="glied ü{count}"/><child link="tip: 手"/></joint>',
    ]
    file = tmp_path / "schlange.urdf"
    file.write_text(f'<robot name="Schlange ü">{"".join(links + joints)}</robot>', encoding="utf-8")
    descriptor, report = import_robot(file, tmp_path / "out", Options())
    robot = load_robot(str(descriptor))
    assert descriptor.name == "schlange_u.yaml"
    assert robot.descriptor.joints == tuple(f"ось {i}" for i in range(count))
    assert robot.descriptor.tip_link == "tip: 手"
    assert sum("the URDF gives no range" in warning for warning in report.warnings) == count


@pytest.mark.lengthy
def test_missing_sizes_and_degrees_are_imported_with_a_warning(tmp_path: Path) -> None:
    sizes = "0.1 0.1 0.1", "0 0 0", "0.1 0.1 0.1"
    links = [
        f'<link name="l{i}"><collision><geometry><box size="{size}"/></geometry></collision></link>'
        for i, size in enumerate(sizes)
    ]
    joints = [
        f'<joint name="j{i}" type="revolute"><parent link="l{i}"/><child link="l{i + 1}"/><origin xyz="0 0 0.3"/>'
        '<axis xyz="0 1 0"/><limit lower="-170" upper="170" velocity="90" effort="1"/></joint>'
        for i in range(2)
    ]
    file = tmp_path / "arm.urdf"
    file.write_text(f'<robot name="arm">{"".join(links + joints)}</robot>')
    _, report = import_robot(file, tmp_path / "out", Options())
    assert report.warnings[0] == "l1: its geometry is smaller than 1 mm, so it is left out; check its size and scale"
    assert sum("is most likely in degrees" in warning for warning in report.warnings) == 2


@pytest.mark.parametrize("kind", ["floating", "planar"])
def test_where_only_floating_joints_move_it_is_refused(tmp_path: Path, kind: str) -> None:
    file = tmp_path / "drone.urdf"
    file.write_text(
        f'<robot name="drone">\n<link name="a"/><link name="b"/>\n<joint name="free" type="{kind}">'
        '<parent link="a"/><child link="b"/></joint>\n</robot>'
    )
    with pytest.raises(InvalidRequest, match=rf"drone\.urdf:3: joint free is {kind}"):
        import_robot(file, tmp_path / "out", Options())


@pytest.mark.parametrize(
    ("inertia", "possible"),
    [
        ((1.0, 1.0, 1.0), True),
        ((1e-6, 1.0, 1.0), True),
        ((0.0, 0.0, 0.0), True),
        ((-1.0, 1.0, 1.0), False),
        ((3.0, 1.0, 1.0), False),
    ],
)
def test_an_inertia_that_no_body_has_is_found(inertia: tuple[float, ...], possible: bool) -> None:
    turn = Rotation.from_rotvec((0.3, 0.2, 0.1)).as_matrix()
    assert unphysical(turn @ np.diag(inertia) @ turn.T) is not possible


def test_a_tip_behind_thousands_of_fixed_links_is_found(tmp_path: Path) -> None:
    count = 3000
    links = "".join(f'<link name="f{i}"/>' for i in range(count))
    joints = "".join(
        f'<joint name="w{i}" type="fixed"><parent link="{f"f{i - 1}" if i else "l2"}"/><child link="f{i}"/></joint>'
        for i in range(count)
    )
    file = tmp_path / "arm.urdf"
    file.write_text(two_joints(more=links + joints))
    assert choose_chain(describe(read_source(file))).tip == f"f{count - 1}"
