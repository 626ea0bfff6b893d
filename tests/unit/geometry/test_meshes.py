"""What meshes promise: the same distances as trimesh, nothing hidden inside, files from the configured folders only."""

from __future__ import annotations

import gc
import hashlib
import os
from base64 import b64encode
from collections.abc import Callable
from pathlib import Path

import fcl
import numpy as np
import pytest
import trimesh

from support.planner.sphere_model import gaps_to_itself, random_joints, spheres
from zarm_contract.errors import InvalidRequest, Unavailable
from zarm_contract.messages import AddObjects, ClearScene, Mesh, SceneEdit, Sphere
from zarm_contract.robot import load_robot
from zarm_geometry import meshes as limits
from zarm_geometry import packed_shapes, solid
from zarm_geometry.collision import is_free
from zarm_geometry.exact import MAX_CLEARANCE, ExactScene
from zarm_geometry.frames import matrix
from zarm_geometry.meshes import Meshes
from zarm_geometry.robot_model import RobotModel
from zarm_geometry.world import World
from zarm_planner.scene.store import SceneStore
from zarm_trajectory.arrays import Array

TURNED = (0.1, -0.5, 0.3, float(np.sqrt(1 - 0.35)))


def mesh(file: str, name: str = "vice", **fields: object) -> Mesh:
    return Mesh.model_validate({"kind": "mesh", "name": name, "position": (0.0, 0.0, 0.0), "file": file} | fields)


def add(*items: Mesh, replace: bool = False) -> SceneEdit:
    return SceneEdit(edit=AddObjects(op="add", objects=items, replace=replace))


def saved(shape: trimesh.Trimesh, path: Path) -> Path:
    shape.export(path)
    return path


def test_of_a_mesh_only_its_shapes_stay_in_memory(tmp_path: Path) -> None:
    def held() -> int:
        kinds = map(type, gc.get_objects())  # isinstance would ask the objects, some of which warn
        return sum(kind is trimesh.Trimesh for kind in kinds)

    saved(trimesh.creation.icosphere(), tmp_path / "ball.stl")
    gc.collect()
    before = held()
    Meshes((tmp_path,)).checked(mesh("ball.stl"), "")
    assert held() == before


@pytest.mark.parametrize("robot", ["panda", "doosan_m1013"])
def test_distances_to_a_mesh_are_those_of_fcl(tmp_path: Path, robot: str) -> None:
    model = RobotModel.of(load_robot(robot))
    shape = trimesh.creation.torus(0.15, 0.05, major_sections=16, minor_sections=8)
    meshes = Meshes((tmp_path,))
    item = meshes.checked(
        mesh(saved(shape, tmp_path / "ring.stl").name, position=(0.5, 0.3, 0.6), orientation=TURNED), ""
    )
    whole = fcl.BVHModel()
    whole.beginModel(len(shape.faces), len(shape.vertices))
    whole.addSubModel(shape.vertices, shape.faces)
    whole.endModel()
    pose = matrix(item.position, item.orientation)
    there = fcl.CollisionObject(whole, fcl.Transform(pose[:3, :3], pose[:3, 3]))

    exact = ExactScene(model, World((item,), 0.005, meshes))
    found = []
    for q in random_joints(model, 40, np.random.default_rng(5)):
        links = model.link_transforms(q)
        apart = np.inf
        for link, part in model.parts:
            if model.link_joint[link] >= 0:
                place = links[link] @ part.pose
                moved = fcl.CollisionObject(part.geometry, fcl.Transform(place[:3, :3], place[:3, 3]))
                apart = min(apart, fcl.distance(moved, there, fcl.DistanceRequest(), fcl.DistanceResult()))
        nearest = exact.nearest(q, itself=False)
        found.append(nearest.distance > 0.0)
        if apart > 1e-6 or nearest.distance > 0.0:
            assert nearest.distance == pytest.approx(min(apart, MAX_CLEARANCE), abs=2e-4)
    assert len(set(found)) == 2


@pytest.mark.lengthy
@pytest.mark.parametrize(("suffix", "closed"), [("stl", True), ("obj", False)])
def test_free_means_that_no_sphere_touches_the_mesh(tmp_path: Path, suffix: str, closed: bool) -> None:
    rng, model = np.random.default_rng(3), RobotModel.of(load_robot("panda"))
    shape = trimesh.creation.torus(0.15, 0.05, major_sections=16, minor_sections=8)
    if not closed:
        shape.update_faces(np.arange(len(shape.faces)) % 5 > 0)
    file = saved(shape, tmp_path / f"ring.{suffix}").name
    meshes = Meshes((tmp_path,))
    item = meshes.checked(mesh(file, position=(0.5, 0.3, 0.6), orientation=TURNED, scale=(1.0, 0.8, 1.5)), "")
    pose = trimesh.transformations.quaternion_matrix(np.roll(TURNED, 1))
    pose[:3, 3] = item.position
    there = shape.copy().apply_transform(pose @ np.diag((*item.scale, 1.0)))

    joints = random_joints(model, 60, rng)
    gaps = gaps_to_itself(model, joints)
    for joint, (centers, radii) in zip(model.link_joint, spheres(model, joints), strict=True):
        if joint >= 0:
            _, apart, _ = trimesh.proximity.closest_point_naive(there, centers.reshape(-1, 3))
            gaps = np.minimum(gaps, (apart.reshape(centers.shape[:2]) - radii).min(axis=1))
    world = World((item,), 0.0, meshes)
    answers = []
    for q, gap in zip(joints, gaps, strict=True):
        if abs(gap) > 1e-5:  # no sphere is wholly inside the ring without another one on its surface
            answers.append(is_free(model, world, q))
            assert answers[-1] == (gap > 0.0)
    assert len(set(answers)) == 2


SHAPES: dict[str, Callable[[], trimesh.Trimesh]] = {
    "box": lambda: trimesh.creation.box((1.0, 0.5, 0.3)),
    "ball": lambda: trimesh.creation.icosphere(2, 0.4),
    "torus": lambda: trimesh.creation.torus(0.4, 0.15, major_sections=24, minor_sections=12),
    "rod": lambda: trimesh.creation.cylinder(0.1, 1.0, sections=100),
    "two": lambda: (
        trimesh.creation.box((0.5, 0.5, 0.5))
        + trimesh.creation.box((0.5, 0.5, 0.5), transform=trimesh.transformations.translation_matrix((0.2, 0.2, 0.1)))
    ),
    "room": lambda: trimesh.creation.box((2.0, 2.0, 2.0)) + turned_inside_out(trimesh.creation.box((1.6, 1.6, 1.6))),
}


def turned_inside_out(shape: trimesh.Trimesh) -> trimesh.Trimesh:
    shape.invert()
    return shape


def winding(triangles: Array, points: Array) -> Array:
    """How often a surface winds around points, by solid angles (Van Oosterom and Strackee, 1983)."""
    a, b, c = np.moveaxis(triangles[None] - points[:, None, None], 2, 0)
    la, lb, lc = (np.linalg.norm(x, axis=2) for x in (a, b, c))
    ab, bc, ca = ((x * y).sum(axis=2) for x, y in ((a, b), (b, c), (c, a)))
    volume = np.einsum("pti,pti->pt", a, np.cross(b, c))
    return np.asarray(np.arctan2(volume, la * lb * lc + ab * lc + bc * la + ca * lb).sum(axis=1) / (2 * np.pi))


@pytest.mark.lengthy
@pytest.mark.parametrize("name", SHAPES)
@pytest.mark.parametrize("turn", [0.0, 0.7])
def test_the_inside_of_a_closed_mesh_is_filled_and_nothing_else(tmp_path: Path, name: str, turn: float) -> None:
    shape = SHAPES[name]().apply_transform(trimesh.transformations.euler_matrix(turn, 2 * turn, -turn))
    found = Meshes((tmp_path,))
    item = found.checked(mesh(saved(shape, tmp_path / "shape.stl").name), "")
    parts = found.tree(item).rows
    lower, upper = packed_shapes.bounds(parts[parts[:, 15] >= 0.0])
    rng = np.random.default_rng(4)
    points = rng.uniform(shape.bounds[0] - 0.05, shape.bounds[1] + 0.05, (150, 3))
    filled = np.any(np.all((points[:, None] > lower) & (points[:, None] < upper), axis=2), axis=1)
    inside = np.abs(winding(np.asarray(shape.triangles), points)) > 0.5
    _, apart, _ = trimesh.proximity.closest_point_naive(shape, points)
    assert not np.any(filled & ~inside)
    diagonal = np.sqrt(3) * shape.extents.max() / 32
    assert np.all(apart[inside & ~filled] <= diagonal)
    assert filled.any()


def test_too_many_cells_are_replaced_by_larger_ones(monkeypatch: pytest.MonkeyPatch) -> None:
    shape = SHAPES["ball"]()
    fine = solid.inside(np.asarray(shape.triangles))
    monkeypatch.setattr(solid, "_PAIRS", 5000)
    lower, upper = solid.inside(np.asarray(shape.triangles))
    assert 0 < len(lower) < len(fine[0])
    assert np.all(np.linalg.norm(np.maximum(abs(lower), abs(upper)), axis=1) < 0.4)


def test_a_closed_mesh_is_solid_and_an_open_one_a_surface(tmp_path: Path) -> None:
    model = RobotModel.of(load_robot("panda"))
    q = np.array(load_robot("panda").descriptor.home)
    x, y, z = np.min([centers.min(axis=(0, 1)) for centers, _ in spheres(model, q[None])], axis=0).tolist()
    shape = trimesh.creation.box((6.0, 6.0, 6.0))
    saved(shape, tmp_path / "hall.stl")
    shape.update_faces(np.arange(len(shape.faces)) > 0)
    saved(shape, tmp_path / "open.stl")
    meshes = Meshes((tmp_path,))
    hall = meshes.checked(mesh("hall.stl", position=(x, y, z)), "")
    still_open = meshes.checked(mesh("open.stl", position=(x, y, z)), "")
    assert not is_free(model, World((hall,), 0.0, meshes), q)
    assert is_free(model, World((still_open,), 0.0, meshes), q)


def with_faults(shape: trimesh.Trimesh, hole: float) -> trimesh.Trimesh:
    """Every fifth triangle is wound the other way, and those around a corner are gone, so that a hole about `hole` wide is left."""
    faces = np.array(shape.faces)
    faces[::5] = faces[::5, ::-1]
    far = np.linalg.norm(shape.vertices - shape.vertices[7], axis=1) < hole / 2
    return trimesh.Trimesh(shape.vertices, faces[~far[faces].any(axis=1)], process=False)


@pytest.mark.lengthy
def test_small_mesh_faults_are_repaired_and_reported(tmp_path: Path) -> None:
    ball = trimesh.creation.icosphere(4, 0.05)
    saved(ball, tmp_path / "whole.stl")
    saved(with_faults(ball, 0.003), tmp_path / "broken.stl")
    saved(with_faults(ball, 0.04), tmp_path / "bowl.stl")
    found = Meshes((tmp_path,))
    whole, broken, bowl = (found.checked(mesh(f"{name}.stl", name), "") for name in ("whole", "broken", "bowl"))
    solid_parts = [rows[rows[:, 15] >= 0.0] for rows in (found.tree(item).rows for item in (whole, broken, bowl))]
    assert found.notes(whole) == ()
    assert [note.split(": ")[0] for note in found.notes(broken)] == ["broken", "broken"]
    assert "turned" in found.notes(broken)[0]
    assert "closed" in found.notes(broken)[1]
    assert sorted(solid_parts[0].tolist()) == sorted(solid_parts[1].tolist())
    assert not len(solid_parts[2])
    assert "only its surface" in found.notes(bowl)[-1]


NOTHING = b"v 0 0 0\nv 1 0 0\nv 0 1 0\n"
FILES = {
    "empty.stl": b"",
    "text.stl": b"this is no mesh\n" * 10,
    "noise.stl": bytes(range(256)) * 4,
    "noise.obj": bytes(range(256)) * 4,
    "points.obj": NOTHING,
    "missing_corner.obj": NOTHING + b"f 1 2 9\n",
    "flat.obj": b"v 0 0\nv 1 0\nv 0 1\nf 1 2 3\n",
    "nan.obj": b"v nan 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n",
    "far.obj": b"v 9000 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n",
    "line.obj": b"v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n",
}


@pytest.mark.lengthy
@pytest.mark.parametrize(
    ("file", "says"),
    [
        ("empty.stl", "no triangles"),
        ("text.stl", "no STL"),
        ("noise.stl", "no STL"),
        ("noise.obj", "not text"),
        ("points.obj", "no triangles"),
        ("missing_corner.obj", "line 4: a face names the vertex 9, and there are 3"),
        ("flat.obj", "line 1: a vertex has three coordinates"),
        ("nan.obj", "not numbers"),
        ("far.obj", "scale 0.001"),
        ("line.obj", "without area"),
        ("nowhere.stl", "no file nowhere.stl"),
        ("picture.png", "neither"),
        ("folder.stl", "not a file"),
        ("pipe.stl", "not a file"),
        ("loop.stl", "cannot read loop.stl"),
        ("a\0b.stl", "cannot read"),
        ("link.stl", "outside"),
        ("../secret.stl", "outside"),
        ("deep/../../secret.stl", "outside"),
        ("/etc/hostname.stl", "check the name"),
    ],
)
def test_an_unusable_file_is_refused_by_field_with_the_remedy(tmp_path: Path, file: str, says: str) -> None:
    home = tmp_path / "meshes"
    (home / "deep").mkdir(parents=True)
    saved(trimesh.creation.box(), tmp_path / "secret.stl")
    for name, content in FILES.items():
        (home / name).write_bytes(content)
    (home / "folder.stl").mkdir()
    os.mkfifo(home / "pipe.stl")
    (home / "loop.stl").symlink_to("loop.stl")
    (home / "link.stl").symlink_to(tmp_path / "secret.stl")
    store = SceneStore(tmp_path / "state", Meshes((home,)))
    saved(trimesh.creation.box(), home / "good.stl")
    with pytest.raises(InvalidRequest, match=says) as caught:
        store.edit(add(mesh("good.stl", "good"), mesh(file)))
    assert caught.value.problem.field == "edit.objects.1.file"
    assert store.scene.objects == ()


def test_an_absolute_path_is_refused_even_where_it_exists(tmp_path: Path) -> None:
    (tmp_path / "meshes").mkdir()
    path = saved(trimesh.creation.box(), tmp_path / "secret.stl")
    with pytest.raises(InvalidRequest, match="outside"):
        Meshes((tmp_path / "meshes",)).checked(mesh(str(path)), "x")


def test_a_planner_without_mesh_folders_says_how_to_give_it_one(tmp_path: Path) -> None:
    with pytest.raises(InvalidRequest, match="--meshes"):
        SceneStore(tmp_path).edit(add(mesh("box.stl")))


def test_too_much_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    saved(trimesh.creation.icosphere(2), tmp_path / "ball.stl")
    monkeypatch.setattr(limits, "MAX_TRIANGLES", 300)
    with pytest.raises(InvalidRequest, match="320 triangles, more than 300"):
        Meshes((tmp_path,)).checked(mesh("ball.stl"), "x")
    monkeypatch.setattr(limits, "MAX_BYTES", 1000)
    with pytest.raises(InvalidRequest, match="more than 1000"):
        Meshes((tmp_path,)).checked(mesh("ball.stl"), "x")


@pytest.mark.parametrize("flipped", [False, True])
def test_duplicate_triangles_leave_a_mesh_closed(tmp_path: Path, flipped: bool) -> None:
    box = trimesh.creation.box((0.3, 0.3, 0.3))
    again = box.faces[:3, ::-1] if flipped else box.faces[:3]
    saved(trimesh.Trimesh(box.vertices, np.vstack([box.faces, again]), process=False), tmp_path / "box.stl")
    meshes = Meshes((tmp_path,))
    item = meshes.checked(mesh("box.stl"), "")
    assert (meshes.tree(item).rows[:, 15] >= 0.0).sum() == 1  # its inside
    assert meshes.notes(item) == ("vice: triangles that were there more than once were taken once",)


def test_degenerate_triangles_are_dropped(tmp_path: Path) -> None:
    box = trimesh.creation.box()
    box.faces = np.concatenate([box.faces, [[0, 0, 1], [2, 2, 2]]])
    (tmp_path / "box.obj").write_text(
        "".join(f"v {x} {y} {z}\n" for x, y, z in box.vertices)
        + "".join(f"f {a} {b} {c}\n" for a, b, c in box.faces + 1)
    )
    meshes = Meshes((tmp_path,))
    parts = meshes.tree(meshes.checked(mesh("box.obj"), "")).rows
    assert np.count_nonzero(parts[:, 15] < 0.0) == 12
    assert np.count_nonzero(parts[:, 15] >= 0.0) == 1


def test_the_scene_keeps_which_file_it_was(tmp_path: Path) -> None:
    saved(trimesh.creation.box(), tmp_path / "box.stl")
    meshes = Meshes((tmp_path,))
    store = SceneStore(tmp_path / "state", meshes)
    (item,) = store.edit(add(mesh("box.stl"))).objects
    assert isinstance(item, Mesh)
    assert item.sha256 is not None
    before = len(World((item,), 0.0, meshes).rows)

    saved(trimesh.creation.icosphere(2), tmp_path / "box.stl")
    assert len(World((item,), 0.0, meshes).rows) == before
    with pytest.raises(InvalidRequest, match="sha256") as caught:
        store.edit(add(item, replace=True))
    assert caught.value.problem.field == "edit.objects.0.sha256"
    (fresh,) = store.edit(add(mesh("box.stl"), replace=True)).objects
    assert len(World((fresh,), 0.0, meshes).rows) > before


@pytest.mark.parametrize("change", ["gone", "changed", "broken"])
def test_no_world_is_made_with_an_unreadable_mesh(tmp_path: Path, change: str) -> None:
    path = saved(trimesh.creation.box(), tmp_path / "box.stl")
    content = path.read_bytes()
    SceneStore(tmp_path / "state", Meshes((tmp_path,))).edit(add(mesh("box.stl")))
    if change == "gone":
        path.unlink()
    else:
        path.write_bytes(b"broken" if change == "broken" else content[:-1] + b"\1")
    store = SceneStore(tmp_path / "state", Meshes((tmp_path,)))
    with pytest.raises(Unavailable, match=r"vice.*box\.stl.*removed or replaced"):
        World(store.scene.objects, 0.0, store.meshes)
    path.write_bytes(content)
    World(store.scene.objects, 0.0, store.meshes)
    assert store.edit(SceneEdit(edit=ClearScene(op="clear"))).objects == ()


def test_a_world_reuses_prepared_meshes(tmp_path: Path) -> None:
    meshes = Meshes((tmp_path,))
    item = meshes.checked(mesh(saved(trimesh.creation.icosphere(2, 0.1), tmp_path / "ball.stl").name), "")
    before = World((item,), 0.0, meshes)
    post = Sphere(kind="sphere", name="post", position=(1.0, 0.0, 0.0), radius=0.1)
    after = World((post, item), 0.005, Meshes(), before)  # which reads no files
    assert sorted(after.names[i] for i in set(after.owner)) == ["post", "vice"]
    assert len(after.rows) == len(before.rows) + 1
    with pytest.raises(Unavailable):
        World((item.model_copy(update={"position": (0.1, 0.0, 0.0)}),), 0.0, Meshes(), before)


def test_a_mesh_that_carries_its_file_needs_no_folder(tmp_path: Path) -> None:
    content = saved(trimesh.creation.box((0.1, 0.1, 0.1)), tmp_path / "box.stl").read_bytes()
    meshes = Meshes()
    carried = mesh("anything.stl", data=b64encode(content).decode())
    held = meshes.checked(carried, "edit.objects.0")
    assert held.sha256 == hashlib.sha256(content).hexdigest()
    assert len(meshes.tree(held).rows) == len(Meshes([tmp_path]).tree(mesh("box.stl")).rows)


@pytest.mark.parametrize(
    ("file", "data", "field", "says"),
    [
        ("box.stl", "no base64", "edit.objects.0.data", "no base64"),
        ("box.stl", "AAAA", "edit.objects.0.file", "cannot be read"),
        ("box.step", "AAAA", "edit.objects.0.file", "neither an .stl nor an .obj"),
    ],
)
def test_a_mesh_that_carries_something_else_is_refused(file: str, data: str, field: str, says: str) -> None:
    with pytest.raises(InvalidRequest, match=says) as refused:
        Meshes().checked(mesh(file, data=data), "edit.objects.0")
    assert refused.value.problem.field == field
