"""The voxel map against exact ray casting: what is seen is occupied, what is seen through is free, and the robot is not there."""

from __future__ import annotations

import re

import numpy as np
import pytest
from numpy.typing import NDArray

from zarm_contract.errors import InvalidRequest
from zarm_contract.image import COUNTS, OF_ROBOT
from zarm_contract.messages import Cuboid, Cylinder, Primitive, Sphere
from zarm_contract.robot import load_robot
from zarm_geometry import packed_shapes
from zarm_geometry.robot_model import RobotModel
from zarm_perception.blocks import Blocks
from zarm_perception.kernels.integration import FREE, OCCUPIED, PASSES, UNSEEN, View
from zarm_perception.robot_shape import RobotShapes
from zarm_perception.saved_map import load, save
from zarm_perception.voxel_map import RobotShape, VoxelMap
from zarm_trajectory.arrays import Array

WIDTH, HEIGHT, FOCAL = 160, 120, 150.0
NOBODY = RobotShape(np.zeros((0, 17)), np.zeros((0, 4)))
WALL = Cuboid(kind="cuboid", name="wall", position=(-0.9, 0.0, 0.5), size=(0.1, 4.0, 4.0))
M1013 = RobotModel.of(load_robot("doosan_m1013"))
HOME = np.array(M1013.robot.descriptor.home)


def looking(eye: tuple[float, float, float], at: tuple[float, float, float], focal: float = FOCAL) -> View:
    z = np.subtract(at, eye) / np.linalg.norm(np.subtract(at, eye))
    x = np.cross(z, [0.0, 0.0, 1.0])
    x /= np.linalg.norm(x)
    turn = np.column_stack((x, np.cross(z, x), z))
    return View(focal, focal, WIDTH / 2 - 0.5, HEIGHT / 2 - 0.5, turn, np.array(eye), 0.1, 4.0)


def rays(view: View) -> Array:
    """The directions (h, w, 3) of the pixels in the base frame, 1 m deep."""
    u, v = np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT))
    local = np.stack(((u - view.cx) / view.fx, (v - view.cy) / view.fy, np.ones(u.shape)), axis=-1)
    return local @ view.turn.T


def image(view: View, shapes: Array) -> NDArray[np.float32]:
    """What an ideal camera sees of shapes (m, 17): sphere tracing, to 0.1 mm; infinite where nothing is."""
    direction = rays(view).reshape(-1, 3)
    length = np.linalg.norm(direction, axis=1)
    depth = np.zeros(len(direction))
    going = np.arange(len(direction))
    for _ in range(200):
        away = packed_shapes.distances(view.place + depth[going, None] * direction[going], shapes).min(axis=1)
        depth[going] += away / length[going]
        going = going[(away > 1e-4) & (depth[going] < 5.0)]
        if not len(going):
            break
    depth[depth >= 5.0] = np.inf
    return depth.reshape(HEIGHT, WIDTH).astype(np.float32)


def seen(view: View, *things: Primitive) -> NDArray[np.float32]:
    return image(view, packed_shapes.primitives([*things]))


def empty_map(*, unseen_occupied: bool = False) -> VoxelMap:
    return VoxelMap(np.full(3, -1.0), np.ones(3), 0.02, unseen_occupied=unseen_occupied)


def cells(voxels: VoxelMap, points: Array) -> NDArray[np.int64]:
    found = np.floor((points - voxels.lower) / voxels.resolution).astype(int)
    return found[np.all((found >= 0) & (found < voxels.states.shape), axis=1)]


def cell_of(voxels: VoxelMap, point: Array) -> tuple[int, int, int]:
    """The voxel that contains a point (3,) of the box."""
    i, j, k = np.floor((point - voxels.lower) / voxels.resolution).astype(int)
    return int(i), int(j), int(k)


def centers(voxels: VoxelMap, which: NDArray[np.bool_]) -> Array:
    return voxels.lower + (np.argwhere(which) + 0.5) * voxels.resolution


def test_where_a_pixel_ends_is_occupied_and_nothing_else_is() -> None:
    view, voxels = looking((1.2, 0.3, 0.8), (0.0, 0.0, 0.0)), empty_map()
    ball = Sphere(kind="sphere", name="ball", position=(0.2, 0.1, 0.2), radius=0.15)
    depth = seen(view, ball, WALL)
    voxels.integrate(depth, view, NOBODY, 0.0)
    ends = (view.place + depth[..., None].astype(float) * rays(view))[1:-1, 1:-1].reshape(-1, 3)
    on_ball = np.abs(np.linalg.norm(ends - ball.position, axis=1) - ball.radius) < 1e-3
    i, j, k = cells(voxels, ends[on_ball]).T
    assert (voxels.states[i, j, k] == OCCUPIED).mean() > 0.97, "but for the pixels on its edge"
    off = packed_shapes.distances(centers(voxels, voxels.occupied), packed_shapes.primitives([ball, WALL])).min(axis=1)
    assert off.max() < 0.02 * np.sqrt(3.0) / 2.0 + 1e-3


@pytest.mark.parametrize("seed", range(4))
def test_what_is_free_was_seen_through_by_every_pixel_on_it(seed: int) -> None:
    """An oracle of its own: the corners of a voxel, and all pixels between them."""
    rng, voxels = np.random.default_rng(seed), empty_map(unseen_occupied=True)
    things = [
        Cuboid(
            kind="cuboid",
            name=f"box{k}",
            position=tuple(rng.uniform(-0.6, 0.6, 3)),
            size=tuple(rng.uniform(0.02, 0.4, 3)),
        )
        for k in range(6)
    ]
    view = looking((1.3, rng.uniform(-0.5, 0.5), rng.uniform(0.2, 1.0)), (0.0, 0.0, 0.0))
    depth = seen(view, *things, WALL)
    voxels.integrate(depth, view, NOBODY, 0.0)
    free = centers(voxels, voxels.states == FREE)
    assert len(free) > 10_000
    corners = np.array(np.meshgrid(*[(-0.01, 0.01)] * 3)).reshape(3, -1).T
    local = (free[:, None] + corners - view.place) @ view.turn
    u = local[..., 0] / local[..., 2] * view.fx + view.cx
    v = local[..., 1] / local[..., 2] * view.fy + view.cy
    for n in rng.choice(len(free), 2000, replace=False):
        left, right = int(np.floor(u[n].min())), int(np.ceil(u[n].max()))
        top, bottom = int(np.floor(v[n].min())), int(np.ceil(v[n].max()))
        assert depth[top : bottom + 1, left : right + 1].min() > local[n, :, 2].max()


def test_what_has_gone_is_free_again_and_what_is_behind_stays() -> None:
    view, voxels = looking((1.2, 0.0, 0.2), (0.0, 0.0, 0.2)), empty_map()
    box = Cuboid(kind="cuboid", name="box", position=(0.0, 0.0, 0.2), size=(0.2, 0.2, 0.2))
    cover = Cuboid(kind="cuboid", name="cover", position=(0.5, 0.0, 0.2), size=(0.02, 0.5, 0.5))
    voxels.integrate(seen(view, box, WALL), view, NOBODY, 0.0)
    front = cell_of(voxels, np.array((0.095, 0.0, 0.2)))
    assert voxels.states[front] == OCCUPIED
    voxels.integrate(seen(view, cover, WALL), view, NOBODY, 0.0)
    assert voxels.states[front] == OCCUPIED, "nobody has seen it go"
    for _ in range(PASSES - 1):
        voxels.integrate(seen(view, WALL), view, NOBODY, 0.0)
        assert voxels.states[front] == OCCUPIED, "noise could have been the reason"
    voxels.integrate(seen(view, WALL), view, NOBODY, 0.0)
    assert voxels.states[front] == FREE
    assert not voxels.occupied[cell_of(voxels, np.array((0.51, 0.0, 0.2)))], "the cover has gone too"


def test_a_thin_rod_is_there_in_every_image() -> None:
    """1 cm thick, 1.5 m away, as a camera of 640 pixels sees it: 4 pixels wide."""
    rod = Cylinder(kind="cylinder", name="rod", position=(0.0, 0.0, 0.0), radius=0.005, length=0.4)
    heights = np.arange(-0.12, 0.12, 0.02)
    rng, voxels = np.random.default_rng(0), empty_map()
    for _ in range(60):
        eye = (1.5, *rng.uniform(-0.02, 0.02, 2))
        view = looking(eye, (0.0, *rng.uniform(-0.02, 0.02, 2)), focal=600.0)
        voxels.integrate(seen(view, rod, WALL), view, NOBODY, 0.0)
        for height in heights:
            i, j, k = cell_of(voxels, np.array((0.001, 0.001, height)))
            around = voxels.occupied[i - 1 : i + 2, j - 1 : j + 2, k]
            assert around.any(), height


def test_the_robot_is_not_in_the_map_and_what_is_near_it_is() -> None:
    shape = RobotShapes(M1013).at(HOME)
    hand = M1013.fk_tip(HOME)[:3, 3]
    near = Sphere(kind="sphere", name="near", position=tuple((hand + (0.0, 0.22, 0.0)).tolist()), radius=0.06)
    view, voxels = looking((1.6, 0.6, 1.1), (0.3, 0.0, 0.4)), empty_map()
    depth = image(view, np.concatenate((shape.parts, packed_shapes.primitives([near]))))
    found = voxels.integrate(depth, view, shape, 0.03)
    assert found.robot > 500
    on_ball = packed_shapes.distances(centers(voxels, voxels.occupied), packed_shapes.primitives([near]))[:, 0] < 0.02
    assert on_ball.all(), "nothing else is occupied"
    assert on_ball.sum() > 20


def test_where_the_robot_is_nothing_else_is() -> None:
    """What it was pushed into, or what came to where it is now, and went unseen behind it."""
    hand = M1013.fk_tip(HOME)[:3, 3]
    ball = Sphere(kind="sphere", name="ball", position=tuple(hand.tolist()), radius=0.08)
    view, voxels, robot = looking((1.6, 0.6, 1.1), (0.3, 0.0, 0.4)), empty_map(), RobotShapes(M1013).at(HOME)
    voxels.integrate(seen(view, ball, WALL), view, NOBODY, 0.0)
    assert packed_shapes.distances(centers(voxels, voxels.occupied), robot.parts).min() < 0.0
    voxels.integrate(np.zeros((HEIGHT, WIDTH), np.float32), view, robot, 0.03)
    away = packed_shapes.distances(centers(voxels, voxels.occupied), robot.parts).min(axis=1)
    assert 0.017 < away.min() < 0.03, "what is near it stays"


def test_the_robot_s_own_place_is_free() -> None:
    """Otherwise, where the unseen counts as occupied, it could never leave its place."""
    voxels = empty_map(unseen_occupied=True)
    view, robot = looking((1.6, 0.6, 1.1), (0.3, 0.0, 0.4)), RobotShapes(M1013).at(HOME)
    assert packed_shapes.distances(centers(voxels, voxels.occupied), robot.parts).min() < 0.0
    voxels.integrate(np.zeros((HEIGHT, WIDTH), np.float32), view, robot, 0.03)
    away = packed_shapes.distances(centers(voxels, voxels.occupied), robot.parts).min(axis=1)
    assert 0.047 < away.min() < 0.06, "as far as nothing beside it can be seen"


def test_the_filter_removes_exactly_what_is_within_the_padding() -> None:
    shape = RobotShapes(M1013).at(HOME)
    view = looking((1.6, 0.6, 1.1), (0.3, 0.0, 0.4))
    around = shape.parts.copy()
    around[:, 16] += 0.04  # all surfaces 4 cm further out
    depth = image(view, around)
    inside, outside = (empty_map().integrate(depth, view, shape, padding) for padding in (0.045, 0.035))
    assert inside.robot == inside.valid - np.count_nonzero(np.isinf(depth))
    assert inside.marking == 0
    assert outside.robot == 0
    assert outside.marking > 500


def test_graspable_objects_are_in_the_scene_and_not_in_the_map() -> None:
    cup = Cylinder(kind="cylinder", name="cup", position=(0.5, 0.3, 0.3), radius=0.04, length=0.1)
    shelf = Cuboid(kind="cuboid", name="shelf", position=(0.5, 0.3, 0.1), size=(0.6, 0.6, 0.3))
    view, voxels = looking((1.6, 0.6, 1.1), (0.5, 0.3, 0.3)), empty_map()
    robot = RobotShapes(M1013, [cup, shelf])
    depth = seen(view, cup, shelf)
    voxels.integrate(depth, view, RobotShapes(M1013).at(HOME), 0.02)
    top = cell_of(voxels, np.array((0.5, 0.3, 0.345)))
    assert voxels.states[top] == OCCUPIED, "nobody has said what it is"
    voxels.take_out(robot.things, 0.02)
    assert voxels.states[top] == FREE
    list(voxels.changes())
    voxels.integrate(depth, view, robot.at(HOME), 0.02)
    off = packed_shapes.distances(centers(voxels, voxels.occupied), packed_shapes.primitives([shelf, cup]))
    assert (off[:, 0] < 0.02).all()
    assert len(off) > 100
    assert off[:, 1].min() > 0.0


@pytest.mark.parametrize("nothing", [0.0, np.nan, 0.05])
def test_what_is_unknown_changes_nothing(nothing: float) -> None:
    view, voxels = looking((1.2, 0.0, 0.2), (0.0, 0.0, 0.2)), empty_map()
    box = Cuboid(kind="cuboid", name="box", position=(0.0, 0.0, 0.2), size=(0.2, 0.2, 0.2))
    voxels.integrate(seen(view, box, WALL), view, NOBODY, 0.0)
    before = voxels.states.copy()
    list(voxels.changes())
    found = voxels.integrate(np.full((HEIGHT, WIDTH), nothing, np.float32), view, NOBODY, 0.0)
    assert found.valid == 0
    np.testing.assert_array_equal(voxels.states, before)
    assert not list(voxels.changes())


def test_pixels_that_fly_between_two_surfaces_mark_nothing() -> None:
    view, voxels = looking((1.2, 0.0, 0.2), (0.0, 0.0, 0.2)), empty_map()
    depth = seen(view, WALL)
    rng = np.random.default_rng(1)
    flying = rng.random(depth.shape) < 0.02
    smeared = np.where(flying, depth * rng.uniform(0.3, 0.9, depth.shape), depth).astype(np.float32)
    voxels.integrate(smeared, view, NOBODY, 0.0)
    off = packed_shapes.distances(centers(voxels, voxels.occupied), packed_shapes.primitives([WALL]))[:, 0]
    assert (off < 0.02).mean() > 0.99


def test_a_single_hole_in_an_image_keeps_nothing() -> None:
    view, voxels = looking((1.2, 0.0, 0.2), (0.0, 0.0, 0.2)), empty_map()
    box = Cuboid(kind="cuboid", name="box", position=(0.0, 0.0, 0.2), size=(0.2, 0.2, 0.2))
    voxels.integrate(seen(view, box, WALL), view, NOBODY, 0.0)
    gone = seen(view, WALL)
    gone[HEIGHT // 2, WIDTH // 2] = 0.0
    for _ in range(PASSES):
        voxels.integrate(gone, view, NOBODY, 0.0)
    assert not voxels.occupied[cell_of(voxels, np.array((0.095, 0.0, 0.2)))]


def test_one_pixel_is_noise_where_a_voxel_appears_on_many() -> None:
    view, voxels = looking((0.1, 0.0, 0.2), (-1.0, 0.0, 0.2)), empty_map()
    depth = seen(view, WALL)
    depth[HEIGHT // 2, WIDTH // 2] -= 0.026
    voxels.integrate(depth, view, NOBODY, 0.0)
    assert packed_shapes.distances(centers(voxels, voxels.occupied), packed_shapes.primitives([WALL])).max() < 0.015


def test_what_nobody_has_seen_is_occupied_if_that_is_asked_for() -> None:
    view, voxels = looking((1.2, 0.0, 0.2), (0.0, 0.0, 0.2)), empty_map(unseen_occupied=True)
    assert voxels.occupied.all()
    voxels.integrate(seen(view, WALL), view, NOBODY, 0.0)
    assert not voxels.occupied[cell_of(voxels, np.array((0.0, 0.0, 0.2)))]
    assert voxels.occupied[cell_of(voxels, np.array((0.9, 0.9, 0.9)))], "beside the image"
    voxels.forget()
    assert voxels.occupied.all()


def test_a_map_is_published_whole_and_then_by_changed_blocks() -> None:
    """One that begins again must free what it had seen before."""
    view, voxels = looking((1.2, 0.0, 0.2), (0.0, 0.0, 0.2)), empty_map()
    blocks, depth = Blocks(voxels), seen(view, WALL)
    voxels.integrate(depth, view, NOBODY, 0.0)
    first = dict(blocks.changed())
    assert len(first) == 7**3
    assert 0 < sum(bool(block.cells) for block in first.values()) < 60
    voxels.integrate(depth, view, NOBODY, 0.0)
    assert not dict(blocks.changed())
    voxels.forget()
    assert {*dict(blocks.changed())} == {name for name, block in first.items() if block.cells}


def test_only_blocks_that_change_are_changes() -> None:
    view, voxels = looking((1.2, 0.0, 0.2), (0.0, 0.0, 0.2)), empty_map()
    box = Cuboid(kind="cuboid", name="box", position=(0.0, 0.0, 0.2), size=(0.1, 0.1, 0.1))
    depth = seen(view, box, WALL)
    voxels.integrate(depth, view, NOBODY, 0.0)
    occupied = np.zeros(voxels.states.shape, np.bool_)
    for index, first, block in voxels.changes():
        begin = np.array(index) * 16
        np.testing.assert_allclose(first, voxels.lower + (begin + 0.5) * 0.02)
        occupied[tuple(slice(b, b + n) for b, n in zip(begin, block.shape, strict=True))] = block
    np.testing.assert_array_equal(occupied, voxels.occupied)
    voxels.integrate(depth, view, NOBODY, 0.0)
    assert not list(voxels.changes())
    assert (voxels.states[voxels.occupied] != UNSEEN).all()


def turning(eye: tuple[float, float, float]) -> View:
    """A LiDAR that sees all around, 40 deg up and down, with the seam of its images."""
    per = 400 / (2.0 * np.pi)
    optical = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
    seam = int(0.5 * per)
    return View(per, 60.0, 199.5 + seam, 42.0, optical, np.array(eye), 0.1, 4.0, True, seam)


def ranges(view: View, *things: Primitive) -> tuple[NDArray[np.float32], Array]:
    """What an ideal LiDAR measures (h, w) with its seam, and the direction (h, w, 3) of each pixel."""
    azimuth = (np.arange(400 + 2 * view.seam) - view.cx) / view.fx
    elevation = (view.cy - np.arange(85)) / view.fy
    level = np.cos(elevation)[:, None]
    up = np.broadcast_to(np.sin(elevation)[:, None], (85, len(azimuth)))
    rays = np.stack((level * np.cos(azimuth), -level * np.sin(azimuth), up), axis=-1)
    shapes, depth, going = (
        packed_shapes.primitives([*things]),
        np.zeros(rays[..., 0].size),
        np.arange(rays[..., 0].size),
    )
    flat = rays.reshape(-1, 3)
    for _ in range(300):
        away = packed_shapes.distances(view.place + depth[going, None] * flat[going], shapes).min(axis=1)
        depth[going] += away
        going = going[(away > 1e-4) & (depth[going] < 5.0)]
        if not len(going):
            break
    depth[depth >= 5.0] = np.inf
    return depth.reshape(up.shape).astype(np.float32), rays


@pytest.mark.parametrize("seed", range(3))
def test_a_lidar_frees_only_what_it_sees_through(seed: int) -> None:
    rng, voxels = np.random.default_rng(seed), empty_map(unseen_occupied=True)
    # One right behind it, across the seam of its image.
    things: list[Primitive] = [Cuboid(kind="cuboid", name="behind", position=(-0.8, 0.0, 0.1), size=(0.2, 0.3, 0.4))]
    for k in range(5):
        at = rng.uniform(-0.8, 0.8, 3)
        at[:2] *= 1.0 if np.hypot(*at[:2]) > 0.4 else 2.0
        size = tuple(rng.uniform(0.05, 0.3, 3))
        things.append(Cuboid(kind="cuboid", name=f"box{k}", position=tuple(at), size=size))
    view = turning((0.0, 0.0, 0.1))
    depth, rays = ranges(view, *things)
    if depth.min() < 0.15:
        pytest.skip("it stands in a box")
    voxels.integrate(depth, view, NOBODY, 0.0)
    inner = (slice(None), slice(view.seam, -view.seam))
    hit = np.isfinite(depth[inner]) & (depth[inner] < 4.0)
    ends = view.place + depth[inner][hit, None] * rays[inner][hit]
    i, j, k = cells(voxels, ends).T
    assert (voxels.states[i, j, k] == OCCUPIED).mean() > 0.8, "but for voxels in which a single pixel ends"
    occupied = centers(voxels, voxels.states == OCCUPIED)
    assert packed_shapes.distances(occupied, packed_shapes.primitives(things)).max() < np.inf
    assert packed_shapes.distances(occupied, packed_shapes.primitives(things)).min(axis=1).max() < 0.02
    free = centers(voxels, voxels.states == FREE)
    assert len(free) > 20_000
    assert (np.abs(free[free[:, 0] < -0.5][:, 1]) < 0.02).any(), "also what is behind it"
    assert packed_shapes.distances(free, packed_shapes.primitives(things)).min() > 0.0, (
        "what is free is outside everything"
    )


def test_a_lidar_leaves_the_robot_out() -> None:
    voxels, view = empty_map(), turning((0.6, 0.6, 0.6))
    shape = RobotShapes(M1013).at(HOME)
    things = Cuboid(kind="cuboid", name="wall", position=(-0.9, 0.0, 0.5), size=(0.1, 1.0, 1.0))
    azimuth = (np.arange(400 + 2 * view.seam) - view.cx) / view.fx
    wall, rays = ranges(view, things)
    assert len(azimuth) == rays.shape[1]
    flat, depth, going = rays.reshape(-1, 3), np.zeros(wall.size), np.arange(wall.size)
    for _ in range(300):
        away = packed_shapes.distances(view.place + depth[going, None] * flat[going], shape.parts).min(axis=1)
        depth[going] += away
        going = going[(away > 1e-4) & (depth[going] < 5.0)]
        if not len(going):
            break
    depth[depth >= 5.0] = np.inf
    seen_robot = np.minimum(depth.reshape(wall.shape).astype(np.float32), wall)
    seen = voxels.integrate(seen_robot, view, shape, 0.03)
    assert seen.robot > 100
    occupied = centers(voxels, voxels.occupied)
    assert len(occupied) > 20
    assert packed_shapes.distances(occupied, packed_shapes.primitives([things])).min(axis=1).max() < 0.02, (
        "only the wall is there"
    )


def test_a_map_is_saved_and_loaded_also_into_another_box() -> None:
    voxels = empty_map()
    view = looking((1.2, 0.3, 0.8), (0.0, 0.0, 0.0))
    voxels.integrate(seen(view, WALL), view, NOBODY, 0.0)
    saved = save(voxels)
    other = empty_map()
    loaded = load(other, saved)
    assert loaded.occupied == int(voxels.occupied.sum()) > 100
    assert loaded.outside == 0
    np.testing.assert_array_equal(other.states, voxels.states)
    assert dict(Blocks(other).changed()) == dict(Blocks(voxels).changed())
    smaller = VoxelMap(np.array([-0.9, -2.0, 0.0]), np.array([0.5, 0.5, 2.0]), 0.02)
    assert load(smaller, saved).outside > 0
    there = centers(smaller, smaller.occupied)
    before = centers(voxels, voxels.occupied)
    inside = before[np.all((before > smaller.lower) & (before < smaller.upper), axis=1)]
    np.testing.assert_allclose(there, inside, atol=1e-9)


@pytest.mark.parametrize(
    ("change", "why"),
    [
        ({"resolution": 0.05}, "start zarm-perception with --resolution 0.05"),
        ({"lower": (-0.995, -1.0, -1.0)}, "start zarm-perception with a --box that begins at -0.995,-1,-1"),
        ({"states": "AAAA"}, "not compressed by zlib"),
        ({"shape": (100, 100, 99)}, "there must be 990000 states"),
        ({"shape": (4096, 4096, 4096)}, "a map has at most 100000000"),
    ],
)
def test_a_saved_map_that_does_not_fit_is_refused(change: dict[str, object], why: str) -> None:
    voxels = empty_map()
    view = looking((1.2, 0.3, 0.8), (0.0, 0.0, 0.0))
    voxels.integrate(seen(view, WALL), view, NOBODY, 0.0)
    before = voxels.states.copy()
    with pytest.raises(InvalidRequest, match=re.escape(why)):
        load(voxels, save(voxels).model_copy(update=change))
    np.testing.assert_array_equal(voxels.states, before)


def test_the_mask_says_what_of_an_image_is_in_the_map() -> None:
    eye = looking((1.8, 0.3, 0.9), (0.0, 0.0, 0.4))
    robot = RobotShapes(M1013).at(HOME)
    depth = image(eye, np.concatenate((robot.parts, packed_shapes.primitives([WALL]))))
    voxels = VoxelMap(np.array((-1.0, -1.0, -0.25)), np.array((1.0, 1.0, 1.25)), 0.02)
    seen = voxels.integrate(depth, eye, robot, 0.03)
    mask = seen.mask()
    assert mask.shape == (HEIGHT, WIDTH)
    assert np.count_nonzero(mask == OF_ROBOT) == seen.robot > 500
    points = eye.place + depth[..., None] * rays(eye)
    away = packed_shapes.distances(points[(mask == COUNTS) & np.isfinite(depth)], robot.parts).min(axis=1)
    assert away.min() > 0.03 - 1e-3
    assert not np.any(mask[~np.isfinite(depth)] == OF_ROBOT)
