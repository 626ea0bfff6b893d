"""Beside meshes of many triangles: the answers of FCL, whichever boxes of the tree are left out on the way."""

from __future__ import annotations

from pathlib import Path

import fcl
import numpy as np
import pytest
import trimesh

from support.planner.small_arm import DESCRIPTOR, URDF
from support.planner.sphere_model import gaps_to_itself, random_joints, spheres
from support.tiers import sampled
from zarm_contract.messages import Mesh, Voxels
from zarm_contract.robot import load_robot
from zarm_geometry import packed_shapes
from zarm_geometry.box_tree import BoxTree
from zarm_geometry.collision import is_free
from zarm_geometry.exact import ExactScene
from zarm_geometry.frames import matrix
from zarm_geometry.kernels import refit
from zarm_geometry.meshes import Meshes
from zarm_geometry.robot_model import RobotModel
from zarm_geometry.world import World

TURNED = (0.1, -0.5, 0.3, float(np.sqrt(1 - 0.35)))
AT = (0.5, 0.2, 0.5)


def bumpy_ball() -> trimesh.Trimesh:
    ball = trimesh.creation.icosphere(subdivisions=4, radius=1.0)
    bumps = 1.0 + 0.3 * np.prod(np.sin(ball.vertices * (5, 7, 6)), axis=1)
    return trimesh.Trimesh(ball.vertices * bumps[:, None] * 0.25, ball.faces)


def slivers() -> trimesh.Trimesh:
    """A lathed part: long thin triangles along it, and fans of them at its ends."""
    rod = trimesh.creation.cylinder(radius=0.08, height=0.5, sections=400)
    flange = trimesh.creation.cylinder(radius=0.2, height=0.04, sections=200)
    return trimesh.util.concatenate([rod, flange])


def rough_plate() -> trimesh.Trimesh:
    """An open surface with noise of 1 mm."""
    x, y = np.meshgrid(np.linspace(-0.4, 0.4, 61), np.linspace(-0.3, 0.3, 46), indexing="ij")
    z = 0.001 * np.random.default_rng(0).standard_normal(x.shape)
    index = np.arange(x.size).reshape(x.shape)
    a, b, c, d = (index[i, j].ravel() for i, j in _QUADS)
    return trimesh.Trimesh(np.stack([x, y, z], axis=-1).reshape(-1, 3), np.vstack([np.c_[a, b, c], np.c_[a, c, d]]))


_ALL, _NEXT = slice(None, -1), slice(1, None)
_QUADS = ((_ALL, _ALL), (_NEXT, _ALL), (_NEXT, _NEXT), (_ALL, _NEXT))
PARTS = {"slivers": slivers, "ball": bumpy_ball, "plate": rough_plate}


@pytest.fixture(scope="module")
def many_balls(tmp_path_factory: pytest.TempPathFactory) -> RobotModel:
    """The small arm with a rod of 70 balls, more than are looked at together."""
    folder = tmp_path_factory.mktemp("robot")
    balls = ", ".join(
        f"{{center: [{0.1 * np.sin(k)}, {0.1 * np.cos(k)}, {0.008 * k}], radius: 0.02}}" for k in range(70)
    )
    solids = balls.replace("{center", "{kind: sphere, center")
    one = "rod: [{center: [0, 0, 0], radius: 0.03}]"
    solid = "rod: [{kind: sphere, center: [0, 0, 0], radius: 0.03}]"
    assert one in DESCRIPTOR
    assert solid in DESCRIPTOR
    (folder / "small_arm.urdf").write_text(URDF)
    (folder / "small_arm.yaml").write_text(
        DESCRIPTOR.replace(one, f"rod: [{balls}]").replace(solid, f"rod: [{solids}]")
    )
    return RobotModel.of(load_robot(str(folder / "small_arm.yaml")))


@pytest.fixture(scope="module")
def panda() -> RobotModel:
    return RobotModel.of(load_robot("panda"))


@pytest.fixture(params=sampled("many_balls", "panda"))
def model(request: pytest.FixtureRequest) -> RobotModel:
    found: RobotModel = request.getfixturevalue(request.param)
    return found


def placed(shape: trimesh.Trimesh, folder: Path, margin: float) -> tuple[World, fcl.CollisionObject]:
    """A mesh in the scene, and the whole of its surface for FCL."""
    shape.export(folder / "part.stl")
    meshes = Meshes((folder,))
    item = Mesh(kind="mesh", name="part", file="part.stl", position=AT, orientation=TURNED)
    whole = fcl.BVHModel()
    whole.beginModel(len(shape.faces), len(shape.vertices))
    whole.addSubModel(shape.vertices, shape.faces)
    whole.endModel()
    pose = matrix(AT, TURNED)
    there = fcl.CollisionObject(whole, fcl.Transform(pose[:3, :3], pose[:3, 3]))
    return World((meshes.checked(item, ""),), margin, meshes), there


def apart(there: fcl.CollisionObject, geometry: object, place: fcl.Transform) -> float:
    """FCL's distance, 0 where it finds a collision."""
    moved = fcl.CollisionObject(geometry, place)
    found: float = fcl.distance(moved, there, fcl.DistanceRequest(), fcl.DistanceResult())
    return max(found, 0.0)


@pytest.mark.lengthy
@pytest.mark.parametrize("part", sampled(*PARTS))
def test_the_sphere_check_agrees_with_fcl_at_the_margin(tmp_path: Path, model: RobotModel, part: str) -> None:
    margin = 0.02
    world, there = placed(PARTS[part](), tmp_path, margin)
    joints = random_joints(model, 25, np.random.default_rng(3))
    own, gaps = gaps_to_itself(model, joints), np.full(len(joints), np.inf)
    for joint, (centers, radii) in zip(model.link_joint, spheres(model, joints), strict=True):
        if joint >= 0:
            for n, k in np.ndindex(centers.shape[:2]):
                gap = apart(there, fcl.Sphere(radii[k]), fcl.Transform(np.eye(3), centers[n, k])) - margin
                gaps[n] = min(gaps[n], gap)
    answers = []
    for q, gap, alone in zip(joints, gaps, own, strict=True):
        if abs(gap) > 1e-4 and alone > 1e-5 and not np.isclose(gap, -margin):
            answers.append(is_free(model, world, q))
            assert answers[-1] == (gap > 0.0)
    assert len(set(answers)) == 2 or model.dof < 7


@pytest.mark.lengthy
@pytest.mark.parametrize("part", sampled(*PARTS))
def test_a_motion_is_as_near_to_a_fine_mesh_as_fcl_measures(tmp_path: Path, model: RobotModel, part: str) -> None:
    world, there = placed(PARTS[part](), tmp_path, 0.005)
    exact, rng, measured = ExactScene(model, world), np.random.default_rng(7), 0
    for start in random_joints(model, 8, rng):
        motion = start + np.linspace(0.0, 1.0, 8)[:, None] * rng.uniform(-0.3, 0.3, model.dof)
        smallest = np.inf
        for q in motion:
            links = model.link_transforms(q)
            for link, shape in model.parts:
                if model.link_joint[link] >= 0:
                    at = links[link] @ shape.pose
                    place = fcl.Transform(at[:3, :3], at[:3, 3])
                    smallest = min(smallest, apart(there, shape.geometry, place))
        found = exact.nearest(motion, itself=False).distance
        if smallest <= 1e-6:
            assert found <= 2e-4
        elif found > 0.0:  # else inside of it, which FCL does not know of a surface
            assert found == pytest.approx(min(smallest, 1.0), abs=2e-4)
            measured += 1
    assert measured > 3


def test_boxes_of_a_moved_object_contain_it_tightly() -> None:
    rng = np.random.default_rng(4)
    cells = tuple(map(tuple, rng.integers(-9, 9, (200, 3)).tolist()))
    triangles = packed_shapes.triangles(rng.normal(size=(300, 1, 3)) + 0.1 * rng.normal(size=(300, 3, 3)))
    voxels = Voxels(kind="voxels", name="seen", resolution=0.1, cells=tuple(dict.fromkeys(cells)))
    for shapes in (triangles, World((voxels,), 0.0).rows):
        pose = matrix(AT, TURNED)
        tree = BoxTree.over(shapes).placed(pose)
        np.testing.assert_allclose(tree.rows, packed_shapes.placed(shapes, pose)[tree.order], atol=1e-12)
        lower, upper = packed_shapes.bounds(tree.rows)
        np.testing.assert_allclose(refit.centers(tree.rows), (lower + upper) / 2, atol=1e-12)
        for node, (box, leaf, skip) in enumerate(zip(tree.boxes, tree.leaf, tree.skip, strict=True)):
            inside = [leaf] if leaf >= 0 else [each for each in tree.leaf[node:skip] if each >= 0]
            np.testing.assert_allclose(box[:3] - box[3:], lower[inside].min(axis=0), atol=1e-12)
            np.testing.assert_allclose(box[:3] + box[3:], upper[inside].max(axis=0), atol=1e-12)
