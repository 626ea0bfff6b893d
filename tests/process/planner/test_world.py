"""Meshes and point clouds as the planner's clients meet them: a planner process with a folder of meshes."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import trimesh
import yaml

from support.command_line import zarm
from support.harness import PATIENCE, ServiceProcess, eventually
from support.planner.client import HOME, KEYS, ROBOT
from support.planner.second_opinion import Collisions
from zarm_contract.errors import InvalidRequest, Unavailable
from zarm_contract.messages import (
    AddObjects,
    CheckRequest,
    ClearScene,
    Cylinder,
    JointGoal,
    Mesh,
    Occupancy,
    OccupancyRequest,
    Plan,
    PlanRequest,
    PointCloud,
    RemoveObjects,
    SceneEdit,
    SceneEdited,
    Sphere,
    Voxels,
)
from zarm_executor.checks import executable
from zarm_runtime.bus import Bus
from zarm_runtime.session import open_client

POST = Cylinder(kind="cylinder", name="post", position=(0.38, 0.38, 0.4), radius=0.039, length=0.9)
BEHIND_POST = (1.6, *HOME[1:])
"""Home turned: the straight way there leads through the post."""
MESH = Mesh(kind="mesh", name="post", position=POST.position, file="posts/post.stl", scale=(0.001, 0.001, 0.001))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of meshes: the post, hardly thicker, in mm."""
    folder = tmp_path_factory.mktemp("meshes")
    (folder / "posts").mkdir()
    trimesh.creation.cylinder(39.1, 900.0, sections=64).export(folder / "posts" / "post.stl")
    return folder


@pytest.fixture(scope="module")
def planner(place: str, folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Bus]:
    """A session to a planner that is ready."""
    state = tmp_path_factory.mktemp("planner")
    with (
        Bus(place) as bus,
        ServiceProcess("planner", place, state, arguments=("--meshes", str(folder))) as process,
    ):
        process.wait_ready(bus, KEYS)
        yield bus
        assert process.process.poll() is None


@pytest.fixture
def empty(planner: Bus) -> Bus:
    """The same, with nothing in the scene."""
    edit(planner, ClearScene(op="clear"))
    return planner


def edit(bus: Bus, change: AddObjects | RemoveObjects | ClearScene) -> SceneEdited:
    return bus.call(KEYS.scene_edit, SceneEdit(edit=change), timeout=PATIENCE)


def add(bus: Bus, *items: Mesh | PointCloud | Voxels | Sphere) -> SceneEdited:
    return edit(bus, AddObjects(op="add", objects=items))


def plan_behind_the_post(bus: Bus) -> Plan:
    request = PlanRequest(start=HOME, goal=JointGoal(kind="joints", position=BEHIND_POST))
    return bus.call(KEYS.plan, request, timeout=PATIENCE)


def assert_around_the_post(plan: Plan) -> None:
    path = executable(plan.trajectory, ROBOT)
    times = np.linspace(0.0, path.duration, int(path.duration / 0.01) + 2)
    collisions = Collisions(ROBOT, (POST,))
    assert any(map(collisions.at, np.linspace(HOME, BEHIND_POST, 100)))
    assert not any(collisions.at(path.at(t)[0]) for t in times)
    assert np.allclose(path.end, BEHIND_POST, atol=1e-6)


def cloud_of_the_post(count: int) -> tuple[tuple[float, float, float], ...]:
    rng = np.random.default_rng(0)
    angle, height = rng.uniform(0.0, 2 * np.pi, count), rng.uniform(-0.45, 0.45, count)
    points = np.column_stack([POST.radius * np.cos(angle), POST.radius * np.sin(angle), height]) + POST.position
    return tuple((x, y, z) for x, y, z in points.tolist())


def test_a_mesh_is_planned_around(empty: Bus) -> None:
    add(empty, MESH)
    found = plan_behind_the_post(empty)
    assert found.clearance > 0.0
    assert_around_the_post(found)


def test_the_cells_that_objects_of_any_kind_reach_into_are_told(empty: Bus) -> None:
    def reached(resolution: float) -> Occupancy:
        return empty.call(KEYS.occupancy, OccupancyRequest(resolution=resolution), timeout=PATIENCE)

    assert reached(0.05).cells == ()
    add(empty, MESH, Sphere(kind="sphere", name="ball", position=(1.0, 0.0, 0.0), radius=0.01))
    edited = add(empty, PointCloud(kind="cloud", name="cloud", points=((1.0, 1.0, 0.0),), resolution=0.01))
    found = reached(0.05)
    assert (found.scene_revision, found.resolution) == (edited.revision, 0.05)
    assert {(20, 0, 0), (20, 20, 0)} <= set(found.cells)
    post = [cell for cell in found.cells if cell[0] < 15]
    assert len({k for _, _, k in post}) == 19  # 0.9 m from -0.05 m on
    add(empty, Sphere(kind="sphere", name="large", position=(2.0, 0.0, 0.0), radius=0.3))
    with pytest.raises(InvalidRequest) as raised:
        reached(0.002)
    assert raised.value.problem.field == "resolution"


def test_collision_with_a_mesh_is_found_with_pair_and_depth(empty: Bus) -> None:
    add(empty, MESH)
    touching = next(q for q in np.linspace(HOME, BEHIND_POST, 100) if Collisions(ROBOT, (POST,)).at(q))
    request = CheckRequest(joints=(HOME, tuple(touching.tolist())))
    free, hit = empty.call(KEYS.check, request, timeout=PATIENCE).results
    assert not free.in_collision
    assert free.clearance > 0.0
    assert hit.in_collision
    assert hit.clearance <= 0.0
    assert hit.pair is not None
    assert hit.pair[1] == "post"


def test_a_hundred_thousand_points_become_voxels_to_plan_around(empty: Bus) -> None:
    points = cloud_of_the_post(100_000)
    add(empty, PointCloud(kind="cloud", name="seen", resolution=0.02, points=points))
    (kept,) = empty.read(KEYS.scene, timeout=PATIENCE).objects
    assert isinstance(kept, Voxels)
    cells = set(kept.cells)
    assert cells == {(round(x / 0.02), round(y / 0.02), round(z / 0.02)) for x, y, z in points}
    assert_around_the_post(plan_behind_the_post(empty))


@pytest.mark.parametrize("unreal", ["NaN", "Infinity", "null"])
def test_a_point_that_is_no_number_is_refused_by_its_place(empty: Bus, place: str, unreal: str) -> None:
    payload = (
        '{"edit": {"op": "add", "objects": [{"kind": "cloud", "name": "seen", "points": [[0, 0, 1], [0, %s, 1]]}]}}'
    )
    with open_client(place) as session:
        (reply,) = session.get(KEYS.scene_edit, payload=payload % unreal, timeout=PATIENCE)
    assert reply.err is not None
    problem = json.loads(reply.err.payload.to_string())
    assert problem["code"] == "invalid_request"
    assert problem["field"].startswith("edit.objects.0")
    assert problem["field"].endswith("points.1.1")
    assert empty.read(KEYS.scene, timeout=PATIENCE).objects == ()


@pytest.mark.parametrize("file", ["posts/nothing.stl", "../../etc/passwd.stl", "/etc/passwd", "posts"])
def test_a_mesh_that_is_not_in_the_folders_is_refused_by_field(empty: Bus, file: str) -> None:
    with pytest.raises(InvalidRequest) as caught:
        add(empty, MESH.model_copy(update={"file": file}))
    assert caught.value.problem.field == "edit.objects.0.file"


def test_no_plan_is_made_while_a_mesh_file_is_missing(endpoint: str, bus: Bus, tmp_path: Path) -> None:
    (tmp_path / "posts").mkdir()
    path = tmp_path / "posts" / "post.stl"
    trimesh.creation.cylinder(39.1, 900.0, sections=64).export(path)
    start = ServiceProcess("planner", endpoint, tmp_path, arguments=("--meshes", str(tmp_path)))
    with start as process:
        process.wait_ready(bus, KEYS)
        add(bus, MESH)
        path.rename(tmp_path / "elsewhere.stl")
        assert_around_the_post(plan_behind_the_post(bus))
        process.kill()
    eventually(lambda: not bus.alive(KEYS.alive("planner", "*")), "the planner is gone")
    with start as process:
        process.wait_ready(bus, KEYS)
        for _ in range(2):
            with pytest.raises(Unavailable, match=r"post.*posts/post\.stl"):
                plan_behind_the_post(bus)
            add(bus, Sphere(kind="sphere", name="ball", position=(0.0, 0.0, 3.0), radius=0.1))
            edit(bus, RemoveObjects(op="remove", names=("ball",)))
        (tmp_path / "elsewhere.stl").rename(path)
        assert_around_the_post(plan_behind_the_post(bus))


def test_the_command_line_edits_meshes_and_voxels(empty: Bus, place: str, tmp_path: Path) -> None:
    def done(*arguments: str) -> str:
        result = zarm("scene", *arguments, ZARM_CONNECT=place)
        assert result.returncode == 0, result.stderr
        return result.stdout

    done("add", "mesh", "vice", "--file", "posts/post.stl", "--at", "1,0,0,0,0,1,0", "--scale", "0.001")
    add(empty, PointCloud(kind="cloud", name="seen", points=cloud_of_the_post(5000)))
    scene = empty.read(KEYS.scene, timeout=PATIENCE)
    vice, seen = scene.objects
    assert isinstance(vice, Mesh)
    assert vice.scale == (0.001, 0.001, 0.001)
    assert isinstance(seen, Voxels)
    listed = done("list")
    assert "posts/post.stl" in listed
    assert f"cells {len(seen.cells)}" in " ".join(listed.split())
    assert len(listed) < 1000
    done("save", str(tmp_path / "scene.yaml"))
    done("clear")
    done("load", str(tmp_path / "scene.yaml"))
    assert empty.read(KEYS.scene, timeout=PATIENCE).objects == scene.objects
    assert yaml.safe_load((tmp_path / "scene.yaml").read_text())["objects"][0]["sha256"] == vice.sha256
