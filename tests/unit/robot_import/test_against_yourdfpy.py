"""Random URDFs, and those of other people: links, joints, limits and masses are those that yourdfpy reads, and so is where
every link is.
"""

from __future__ import annotations

import random
import site
from pathlib import Path
from xml.sax.saxutils import quoteattr

import numpy as np
import pytest
import yourdfpy
from hypothesis import given
from hypothesis import strategies as st

from support.examples import examples
from zarm_contract.errors import InvalidRequest
from zarm_robot_import.description import Description, describe
from zarm_robot_import.source import read_source
from zarm_trajectory.arrays import Array

pytestmark = pytest.mark.lengthy


ROBOTS = Path(site.getsitepackages()[0]) / "cmeel.prefix" / "share" / "example-robot-data" / "robots"
FILES = sorted(ROBOTS.rglob("*.urdf"))
CONFIGURATIONS = 100
NAMES = ("link", "arm", "Gelenk", "关节", "звено", "وصلة", "リンク", "part.of-it", "a_b")


def numbers(rng: random.Random, count: int, scale: float = 1.0) -> str:
    return rng.choice((" ", "  ", "\n ")).join(
        f"{rng.uniform(-scale, scale):.{rng.randint(1, 9)}g}" for _ in range(count)
    )


def random_urdf(rng: random.Random) -> str:
    """A tree of up to 12 links, as many exporters and people write one."""
    links = [f"{rng.choice(NAMES)}_{k}" for k in range(rng.randint(2, 12))]
    parts = ["<!-- a robot -->"]
    for link in links:
        inertial = (
            f'<inertial><origin xyz="{numbers(rng, 3)}"/><mass value="{rng.uniform(0, 9):.5g}"/><inertia ixx="1" ixy="0" ixz="0" '
            'iyy="1" iyz="0" izz="1"/></inertial>'
        )
        shape = rng.choice(
            ('<box size="0.1 0.2 0.3"/>', '<sphere radius="0.1"/>', '<cylinder radius="0.1" length="0.2"/>')
        )
        body = f'<collision><origin xyz="{numbers(rng, 3)}"/><geometry>{shape}</geometry></collision>'
        parts.append(f"<link name={quoteattr(link)}>{rng.choice(('', inertial))}{rng.choice(('', body))}</link>")
    for k, child in enumerate(links[1:], 1):
        kind = rng.choice(("fixed", "revolute", "continuous", "prismatic"))
        parent = links[rng.randrange(max(0, k - 2), k)]
        place = "".join(
            (rng.choice(("", f' xyz="{numbers(rng, 3)}"')), rng.choice(("", f' rpy="{numbers(rng, 3, 3.0)}"')))
        )
        origin = rng.choice(("", f"<origin{place}/>"))
        axis = (
            rng.choice(("", f'<axis xyz="{numbers(rng, 3, 5.0)}"/>', '<axis xyz="0 0 -1"/>')) if kind != "fixed" else ""
        )
        limit = f'<limit effort="{rng.uniform(0, 9):.3g}" velocity="{rng.uniform(0.1, 3):.3g}"'
        limit += (
            f' lower="{rng.uniform(-3, 0):.4g}" upper="{rng.uniform(0.1, 3):.4g}"/>' if kind != "continuous" else "/>"
        )
        limit = limit if kind in ("revolute", "prismatic") or (kind == "continuous" and rng.random() < 0.5) else ""
        inside = [f"<parent link={quoteattr(parent)}/>", f"<child link={quoteattr(child)}/>", origin, axis, limit]
        inside.append(rng.choice(("", "<!-- why -->", '<dynamics damping="0.1"/>')))
        rng.shuffle(inside)
        parts.append(f'<joint name={quoteattr(f"to_{child}")} type="{kind}">{"".join(inside)}</joint>')
    rng.shuffle(parts)
    return f"<?xml version='1.0' encoding='utf-8'?>\n<robot name=\"any\">{''.join(parts)}</robot>"


def turned(axis: Array, angles: Array) -> Array:
    """Rodrigues' formula, (n, 3, 3)."""
    cross = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    return np.eye(3) + np.sin(angles)[:, None, None] * cross + (1 - np.cos(angles))[:, None, None] * (cross @ cross)


def theirs(robot: yourdfpy.Robot, values: dict[str, Array]) -> dict[str, Array]:
    """Where yourdfpy's links are, (n, 4, 4)."""
    children = {joint.child for joint in robot.joints}
    (root,) = [link.name for link in robot.links if link.name not in children]
    poses, waiting = {root: np.tile(np.eye(4), (CONFIGURATIONS, 1, 1))}, list(robot.joints)
    while waiting:
        joint = waiting.pop(0)
        if joint.parent not in poses:
            waiting.append(joint)
            continue
        motion = np.tile(np.eye(4), (CONFIGURATIONS, 1, 1))
        if joint.type in ("revolute", "continuous"):
            motion[:, :3, :3] = turned(np.asarray(joint.axis) / np.linalg.norm(joint.axis), values[joint.name])
        elif joint.type == "prismatic":
            axis = np.asarray(joint.axis) / np.linalg.norm(joint.axis)
            motion[:, :3, 3] = values[joint.name][:, None] * axis
        origin = np.eye(4) if joint.origin is None else joint.origin
        poses[joint.child] = poses[joint.parent] @ origin @ motion
    return poses


def ours(robot: Description, values: dict[str, Array]) -> dict[str, Array]:
    """Where zarm's links are, (n, 4, 4)."""
    poses, order = {robot.root: np.tile(np.eye(4), (CONFIGURATIONS, 1, 1))}, [robot.root]
    for link in order:
        for joint in robot.children.get(link, ()):
            moves = joint.type in ("revolute", "continuous", "prismatic")
            motion = joint.motions(values[joint.name]) if moves else np.eye(4)
            poses[joint.child] = poses[link] @ joint.origin @ motion
            order.append(joint.child)
    return poses


def assert_alike(robot: Description, other: yourdfpy.Robot, rng: np.random.Generator) -> None:
    assert set(robot.links) == {link.name for link in other.links}
    joints = {joint.name: joint for joint in robot.joint_of_child.values()}
    assert set(joints) == {joint.name for joint in other.joints}
    for link in other.links:
        mass = robot.links[link.name].element.find("inertial/mass")
        stated = link.inertial.mass if link.inertial is not None else None
        assert (None if mass is None else float(mass.get("value", ""))) == stated
        assert len(robot.links[link.name].collision) == len(link.collisions)
        assert len(robot.links[link.name].visual) == len(link.visuals)
    for joint in other.joints:
        assert joints[joint.name].type == joint.type
        soft = joints[joint.name].element.find("safety_controller") is not None
        if joint.type in ("revolute", "prismatic") and joint.limit is not None and not soft:
            found = joints[joint.name]
            assert (found.lower, found.upper) == (joint.limit.lower or 0.0, joint.limit.upper or 0.0)
            assert found.velocity == joint.limit.velocity
    values = {name: rng.uniform(-3, 3, CONFIGURATIONS) for name in joints}
    here, there = ours(robot, values), theirs(other, values)
    assert set(here) == set(there)
    for link, poses in here.items():
        np.testing.assert_allclose(poses, there[link], atol=1e-6 * max(1.0, float(np.abs(poses).max())))


def described(file: Path) -> Description | str:
    """The robot in a file, or why it is refused."""
    try:
        return describe(read_source(file, [ROBOTS.parents[1]]))
    except InvalidRequest as refusal:
        return str(refusal)


def test_random_urdfs_are_read_as_yourdfpy_reads_them(tmp_path_factory: pytest.TempPathFactory) -> None:
    file = tmp_path_factory.mktemp("urdf") / "any.urdf"

    @examples(40)
    @given(seed=st.integers(0, 2**32))
    def check(seed: int) -> None:
        file.write_text(random_urdf(random.Random(seed)), encoding="utf-8")
        other = yourdfpy.URDF.load(str(file), load_meshes=False, build_scene_graph=False).robot
        assert_alike(describe(read_source(file)), other, np.random.default_rng(seed))

    check()


@pytest.mark.parametrize("file", FILES, ids=lambda file: f"{file.parents[1].name}-{file.stem}")
def test_foreign_robots_are_read_as_by_yourdfpy_or_refused(file: Path) -> None:
    robot = described(file)
    if isinstance(robot, str):
        assert f"{file}:" in robot
        return
    other = yourdfpy.URDF.load(str(file), load_meshes=False, build_scene_graph=False).robot
    assert_alike(robot, other, np.random.default_rng(0))


def test_the_robots_of_others_are_there() -> None:
    assert len(FILES) > 60
