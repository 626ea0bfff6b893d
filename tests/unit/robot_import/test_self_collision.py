"""A pair of links is left out only where the links' own meshes touch always, or never."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

from zarm_contract.collision import CollisionSphere
from zarm_robot_import.chain import choose_chain
from zarm_robot_import.contacts import Contacts
from zarm_robot_import.description import describe
from zarm_robot_import.fitting import Fitted
from zarm_robot_import.limits import limits_of
from zarm_robot_import.meshes import Surface, link_surface
from zarm_robot_import.primitives import packed_shapes_of
from zarm_robot_import.protrusion import Out
from zarm_robot_import.self_collision import Pair, Pairs
from zarm_robot_import.source import read_source
from zarm_robot_import.visual_meshes import without_contradictions


def imported(file: Path, *links: str, travel: float = 0.0) -> tuple[dict[str, Surface], dict[frozenset[str], Pair]]:
    """What is taken of some links of an arm, and their pairs, with one ball around each as its exact geometry; a gripper moves the last
    one by `travel` (m).
    """
    robot = describe(read_source(file))
    chain = choose_chain(robot)
    found = [link_surface(robot.source, robot.links[link]) for link in links]
    surfaces = [surface for surface in found if surface]
    contacts = Contacts(chain, limits_of(robot, chain.joints), surfaces)
    surfaces = without_contradictions(surfaces, contacts)
    pairs = Pairs(contacts, [around(surface) for surface in surfaces], {links[-1]: travel}).judged()
    return {surface.link: surface for surface in surfaces}, {
        frozenset((pair.first, pair.second)): pair for pair in pairs
    }


def around(surface: Surface) -> Fitted:
    corners = surface.triangles.reshape(-1, 3)
    x, y, z = corners.mean(axis=0).tolist()
    radius = float(np.linalg.norm(corners - (x, y, z), axis=1).max())
    ball, out = CollisionSphere(center=(x, y, z), radius=radius), Out(0.0, 0.0, 0.0)
    return Fitted(surface.link, [ball], packed_shapes_of([ball]), np.array([(x, y, z, radius)]), out, out)


def arm(folder: Path, collision: str, visual: str = "") -> Path:
    """Three links: a post, an elbow 0.3 m above it, and a bar of 0.2 m that turns about the elbow and about itself.

    The bar's collision geometry is `collision`, and what is seen of it `visual`.
    """
    post = '<collision><origin xyz="0 0 0.1"/><geometry><box size="0.1 0.1 0.2"/></geometry></collision>'
    elbow = '<collision><geometry><sphere radius="0.03"/></geometry></collision>'
    limit = '<limit lower="-3" upper="3" velocity="1" effort="1"/>'
    file = folder / "arm.urdf"
    file.write_text(
        f'<robot name="arm"><link name="post">{post}</link><link name="elbow">{elbow}</link><link name="bar">'
        f'<collision><origin xyz="0 0 0.1"/>{collision}</collision>{visual}</link>'
        f'<joint name="one" type="revolute"><parent link="post"/><child link="elbow"/><origin xyz="0 0 0.3"/><axis xyz="0 1 0"/>{limit}'
        f'</joint><joint name="two" type="revolute"><parent link="elbow"/><child link="bar"/><axis xyz="0 0 1"/>{limit}</joint></robot>'
    )
    return file


def seen(height: float, length: float, width: float = 0.04) -> str:
    """A visual mesh: a box of `length` and `width` m about the bar's axis, `height` m from the elbow."""
    return f'<visual><origin xyz="0 0 {height}"/><geometry><box size="{width} {width} {length}"/></geometry></visual>'


BAR = '<geometry><box size="0.04 0.04 0.2"/></geometry>'
SHORT = '<geometry><box size="0.04 0.04 0.04"/></geometry>'
ENDS = frozenset(("post", "bar"))


def test_a_pair_that_parts_stays_checked(tmp_path: Path) -> None:
    surfaces, pairs = imported(arm(tmp_path, BAR), "post", "elbow", "bar")
    assert not pairs[ENDS].ignored
    assert surfaces["bar"].kind == "collision"


def test_a_pair_that_a_gripper_may_bring_together_stays_checked(tmp_path: Path) -> None:
    file = arm(tmp_path, '<geometry><box size="0.02 0.02 0.02"/></geometry>')
    file.write_text(file.read_text().replace('xyz="0 0 0.3"', 'xyz="0 0 0.33"'))
    assert imported(file, "post", "elbow", "bar")[1][ENDS].ignored
    assert not imported(file, "post", "elbow", "bar", travel=0.03)[1][ENDS].ignored


def test_visible_parts_are_kept_however_far_they_stick_out(tmp_path: Path) -> None:
    surfaces, pairs = imported(arm(tmp_path, SHORT, seen(0.15, 0.3)), "post", "elbow", "bar")
    assert surfaces["bar"].kind == "both"
    assert np.ptp(surfaces["bar"].triangles[..., 2]) > 0.29
    assert not pairs[ENDS].ignored


def test_a_visual_mesh_that_always_collides_is_left_out(tmp_path: Path) -> None:
    surfaces, pairs = imported(arm(tmp_path, BAR, seen(0.0, 0.25, 0.25)), "post", "elbow", "bar")
    assert surfaces["bar"].kind == "collision"
    assert np.ptp(surfaces["bar"].triangles[..., 2]) < 0.21
    assert "with it bar and post touch in" in surfaces["bar"].warnings[0]
    assert not pairs[ENDS].ignored


@pytest.mark.lengthy
def test_panda_pairs_that_part_and_touch_are_checked() -> None:
    spec = find_spec("rtbdata")
    assert spec is not None
    assert spec.submodule_search_locations
    file = Path(spec.submodule_search_locations[0]) / "xacro/qut_frankie_description/robots/panda_arm_hand.urdf.xacro"
    surfaces, pairs = imported(file, "panda_link1", "panda_link3", "panda_hand")
    assert not pairs[frozenset(("panda_link1", "panda_link3"))].ignored
    assert surfaces["panda_link3"].kind == surfaces["panda_hand"].kind == "both"
