"""`zarm robot import`: an arm is planned for as its URDF is, and nothing that is planned touches itself or a post."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path

import fcl
import numpy as np
import pytest
import trimesh

from support.command_line import zarm
from support.original_meshes import OriginalRobot, original_meshes, touch
from support.tiers import sampled
from zarm_contract.errors import DeadlineExceeded, PlanningFailed
from zarm_contract.messages import JointGoal, Sphere
from zarm_contract.robot import RobotDescription, load_robot
from zarm_geometry.exact import ExactScene
from zarm_geometry.packed_shapes import bounds, distances
from zarm_geometry.robot_model import RobotModel
from zarm_geometry.world import World
from zarm_planner.context import PlanningContext
from zarm_planner.deadline import Deadline
from zarm_planner.pipeline import plan
from zarm_planner.planners.free import FreePlanner
from zarm_planner.scene.planning_scene import PlanningScene
from zarm_robot_import.primitives import packed_shapes_of
from zarm_trajectory.limits import Limits

PATIENCE = 600.0
POST = (-0.35, 0.3, 0.4)
RADIUS = 0.05


def elbow(folder: Path) -> Path:
    """The description of a small arm of three joints, whose links are meshes."""
    links, joints, parent = ['<link name="base"/>'], [], "base"
    for number, (length, axis, height) in enumerate(((0.2, "0 0 1", 0.1), (0.3, "0 1 0", 0.25), (0.25, "0 1 0", 0.35))):
        tube = trimesh.creation.cylinder(0.04, length, sections=24)
        tube.apply_translation((0.0, 0.0, length / 2))
        tube.export(folder / f"part_{number}.stl")
        links.append(
            f'<link name="part_{number}"><collision><geometry><mesh filename="part_{number}.stl"/></geometry></collision></link>'
        )
        joints.append(
            f'<joint name="turn_{number}" type="revolute"><parent link="{parent}"/><child link="part_{number}"/>'
            f'<origin xyz="0 0 {height}"/><axis xyz="{axis}"/><limit lower="-2" upper="2" velocity="1" effort="1"/></joint>'
        )
        parent = f"part_{number}"
    file = folder / "elbow.urdf"
    file.write_text(f'<robot name="elbow">{"".join(links + joints)}</robot>')
    return file


def vendors(arm: str) -> Path:
    """The vendor's description, as the package airo-models carries it."""
    spec = find_spec("airo_models")
    assert spec is not None
    assert spec.submodule_search_locations
    return Path(spec.submodule_search_locations[0]) / "arms" / arm / f"{arm}.urdf"


@pytest.fixture(scope="module", params=sampled("elbow", "ur5e", "ur3e"))
def source(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return elbow(tmp_path_factory.mktemp("source")) if request.param == "elbow" else vendors(request.param)


@pytest.fixture(scope="module")
def arm(source: Path, tmp_path_factory: pytest.TempPathFactory) -> RobotDescription:
    folder = tmp_path_factory.mktemp("imported")
    arguments = ("--geometry", "collision", "--output", str(folder))
    made = zarm("robot", "import", str(source), *arguments, timeout=PATIENCE)
    assert made.returncode == 0, made.stderr
    assert {file.suffix for file in folder.iterdir()} == {".yaml", ".urdf", ".md", ".png"}
    return load_robot(str(folder / f"{source.stem}.yaml"))


@pytest.fixture(scope="module")
def model(arm: RobotDescription) -> RobotModel:
    return RobotModel.of(arm)


@pytest.fixture(scope="module")
def meshes(source: Path) -> dict[str, np.ndarray]:
    """The triangles of the original collision geometry."""
    return original_meshes(source)


@pytest.mark.timeout(PATIENCE)
def test_exact_geometry_contains_the_meshes_and_the_cover_both(
    arm: RobotDescription, meshes: dict[str, np.ndarray]
) -> None:
    rng = np.random.default_rng(5)
    for link, triangles in meshes.items():
        exact = packed_shapes_of(arm.descriptor.collision[link])
        balls = np.array([(*ball.center, ball.radius) for ball in arm.descriptor.spheres[link]])
        points = np.einsum("nk,nki->ni", rng.dirichlet((1, 1, 1), len(triangles)), triangles)
        assert distances(np.concatenate([points, triangles.reshape(-1, 3)]), exact).min(axis=1).max() < 1e-9
        lower, upper = bounds(exact)
        around = rng.uniform(lower.min(axis=0), upper.max(axis=0), (20_000, 3))
        inside = around[distances(around, exact).min(axis=1) < 0.0]
        assert (np.linalg.norm(inside[:, None] - balls[:, :3], axis=2) - balls[:, 3]).min(axis=1).max() < 1e-9


@pytest.mark.slow
@pytest.mark.timeout(PATIENCE)
def test_its_motions_around_a_post_touch_nothing_by_fcl(model: RobotModel, meshes: dict[str, np.ndarray]) -> None:
    world = World([Sphere(kind="sphere", name="post", position=POST, radius=RADIUS)], 0.005)
    scene = PlanningScene("1-000000000000", model, world, ExactScene(model, world))
    rng = np.random.default_rng(3)
    home = np.array(model.robot.descriptor.home)
    original = OriginalRobot(model, meshes)
    post = fcl.CollisionObject(fcl.Sphere(RADIUS), fcl.Transform(np.array(POST)))
    planned = 0
    for goal in rng.uniform(np.maximum(model.lower, -np.pi), np.minimum(model.upper, np.pi), (15, model.dof)):
        try:
            context = PlanningContext(scene, Limits.of(model.robot), Deadline(10.0), seed=0)
            found = plan(FreePlanner(), context, home, JointGoal(kind="joints", position=tuple(goal)))
        except (PlanningFailed, DeadlineExceeded):
            continue
        planned += 1
        for q in found.trajectory.position[::5]:
            objects = original.placed(q)
            for i, j in model.pairs.tolist():
                assert not touch(objects[model.links[i]], objects[model.links[j]])
            for link, joint in zip(model.links, model.link_joint.tolist(), strict=True):
                assert joint < 0 or not touch(objects[link], post)
    assert planned >= 3
