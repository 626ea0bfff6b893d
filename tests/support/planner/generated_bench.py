"""Generated problems, after those MotionBenchMaker scenes whose problems are missing in ../shared.

A cage whose front is two bars, shelves of two shapes, and the way from under a table onto it. The scene is turned and
moved at random about the robot's base, and the tool points forwards into it. (Chamzas et al., "MotionBenchMaker: A Tool
to Generate and Benchmark Motion Planning Datasets", 2022; the sizes are those of its scenes.)
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import numpy as np

from support.planner.motion_bench import Problem
from zarm_contract.messages import Cuboid, Cylinder, SceneObject
from zarm_geometry.collision import is_free
from zarm_geometry.frames import pose_of
from zarm_geometry.robot_model import RobotModel
from zarm_geometry.world import World
from zarm_planner.deadline import Deadline
from zarm_planner.kinematics.ik import solve_ik
from zarm_trajectory.arrays import Array

SCENES = ("cage", "bookshelf_tall", "bookshelf_thin", "table_under_pick")

_HOME = {"panda": (0.0, -0.785, 0.0, -2.356, 0.0, 1.571, 0.785), "ur5": (1.57, -1.571, 0.0, -1.571, -1.57, 3.14)}
"""The start of all but one of MotionBenchMaker's motions."""
_MOUNTED = {"panda": (0.0, 0.0), "ur5": (0.9144, 1.57)}
"""Height (m) and rotation (rad) of the robot in its base frame."""
_PLACES = {
    "cage": {"panda": (0.0, -0.18), "ur5": (0.0, -0.8)},
    "bookshelf_tall": {"panda": (0.3, -0.7), "ur5": (0.1, -0.9)},
    "bookshelf_thin": {"panda": (-0.1, -0.7), "ur5": (0.0, -0.9)},
    "table_under_pick": {"panda": (0.1, -0.5), "ur5": (0.0, -0.45)},
}
"""Position forwards and up (m) of the origin of a scene relative to the robot."""
_TOOL = {
    "panda": np.array(((0.0, 0.0, 1.0), (0.0, 1.0, 0.0), (-1.0, 0.0, 0.0))),
    "ur5": np.array(((0.0, 0.0, 1.0), (-1.0, 0.0, 0.0), (0.0, -1.0, 0.0))),
}
"""The tool forwards, in the scene's axes."""
_GRASP = {"panda": 0.015, "ur5": 0.17}
"""Distance (m) from the tip to the object it grasps."""


def problems(name: str, model: RobotModel, scene: str, count: int) -> list[Problem]:
    """The first `count` problems of a robot (`panda` or `ur5`, as `motion_bench.robot` makes them) in a scene."""
    return list(itertools.islice(_problems(name, model, scene), count))


def _problems(name: str, model: RobotModel, scene: str) -> Iterator[Problem]:
    random = np.random.default_rng([SCENES.index(scene), len(name)])
    for index in itertools.count(1):
        turn = random.uniform(-1.0, 1.0) * (0.5 if scene == "cage" else 1.57)
        moved = random.uniform(-0.1, 0.1, 3) * (1.0, 1.0, float(scene == "cage"))
        height, mounted = _MOUNTED[name]
        place = _turned(turn + mounted)
        forwards, up = _PLACES[scene][name]
        place[:3, 3] = place[:3, :3] @ (moved + (forwards, 0.0, 0.0)) + (0.0, 0.0, height + up)
        objects, start, goal = _SCENES[scene](place, random)
        world = World(objects, 0.0)
        home = np.array(_HOME[name])
        begin = home if start is None else _reached(model, world, name, place @ start, home)
        end = _reached(model, world, name, place @ goal, home)
        if begin is None or end is None or not is_free(model, world, begin):
            continue
        pose = pose_of(model.fk_tip(end))
        yield Problem(index, tuple(begin.tolist()), (tuple(end.tolist()),), (pose,), objects)


def _reached(model: RobotModel, world: World, name: str, place: Array, home: Array) -> Array | None:
    pose = place.copy()
    pose[:3, :3] = place[:3, :3] @ _TOOL[name]
    pose[:3, 3] -= _GRASP[name] * place[:3, 0]
    found = solve_ik(model, pose, home, world=world, max_solutions=16, seed=0, deadline=Deadline(60.0)).solutions
    return found[0] if len(found) else None


def _turned(angle: float) -> Array:
    pose = np.eye(4)
    pose[:2, :2] = ((np.cos(angle), -np.sin(angle)), (np.sin(angle), np.cos(angle)))
    return pose


def _at(x: float, y: float, z: float) -> Array:
    pose = np.eye(4)
    pose[:3, 3] = x, y, z
    return pose


Scene = tuple[tuple[SceneObject, ...], Array | None, Array]
"""Objects, and the tip poses at the start, if not at home, and at the goal (4, 4), in the scene's axes."""


def _boxes(place: Array, *boxes: tuple[tuple[float, float, float], tuple[float, float, float]]) -> list[SceneObject]:
    """Cuboids from sizes and centres (m)."""
    found: list[SceneObject] = []
    for number, (size, centre) in enumerate(boxes):
        pose = pose_of(place @ _at(*centre))
        found.append(
            Cuboid(kind="cuboid", name=f"box{number}", size=size, position=pose.position, orientation=pose.orientation)
        )
    return found


def _can(place: Array, name: str, x: float, y: float, z: float) -> Cylinder:
    pose = pose_of(place @ _at(x, y, z))
    return Cylinder(
        kind="cylinder", name=name, radius=0.03, length=0.14, position=pose.position, orientation=pose.orientation
    )


def _cage(place: Array, random: np.random.Generator) -> Scene:
    objects = _boxes(
        place,
        ((0.07, 0.07, 0.07), (0.8, 0.0, 0.52)),
        ((0.7, 0.7, 0.04), (0.8, 0.0, 0.44)),
        ((0.7, 0.04, 0.7), (0.8, -0.35, 0.8)),
        ((0.7, 0.04, 0.7), (0.8, 0.35, 0.8)),
        ((0.04, 0.7, 0.04), (0.45, 0.0, 0.9)),
        ((0.04, 0.7, 0.04), (0.45, 0.0, 0.6)),
        ((0.65, 0.65, 0.04), (0.85, 0.0, 1.15)),
        ((0.04, 0.7, 0.7), (1.15, 0.0, 0.8)),
    )
    x, y, z = random.uniform((0.7, -0.15, 0.6), (0.85, 0.15, 0.9))
    return tuple(objects), None, _at(x, y, z)


def _bookshelf_tall(place: Array, random: np.random.Generator) -> Scene:
    boards = [((1.2, 1.0, 0.04), (1.0, 0.0, z)) for z in (0.7, 1.0, 1.3, 1.6)]
    sides = [((1.3, 0.04, 1.64), (1.0, y, 0.82)) for y in (-0.5, 0.5)]
    spots = [(x, random.uniform(-0.3, 0.3), z) for z in (0.79, 1.09, 1.39) for x in (0.9, 0.7, 0.5)]
    cans = [_can(place, f"can{number}", *spot) for number, spot in enumerate(spots)]
    x, y, z = spots[random.integers(len(spots))]
    return (*_boxes(place, *boards, *sides), *cans), None, _at(x, y, z + 0.03)


def _bookshelf_thin(place: Array, random: np.random.Generator) -> Scene:
    boards = [((0.62, 1.0, 0.04), (1.0, 0.0, z)) for z in (0.35, 0.6, 0.85, 1.1, 1.35, 1.6)]
    legs = [((0.04, 0.04, 1.64), (x, y, 0.82)) for x, y in itertools.product((0.7, 1.3), (-0.5, 0.5))]
    middle = ((0.62, 0.04, 1.4), (1.0, 0.0, 0.9))
    sides = ((0.44, 0.25), (0.69, -0.25), (0.94, 0.25), (1.19, -0.25))
    spots = [(x, y + random.uniform(-0.15, 0.15), z) for z, y in sides for x in (0.8, 1.1)]
    cans = [_can(place, f"can{number}", *spot) for number, spot in enumerate(spots)]
    x, y, z = spots[2 * random.integers(len(sides))]
    return (*_boxes(place, *boards, *legs, middle), *cans), None, _at(x, y, z + 0.03)


def _table_under_pick(place: Array, random: np.random.Generator) -> Scene:
    legs = [((0.05, 0.05, 0.7), (x, y, 0.35)) for x, y in itertools.product((0.6, 1.5), (-0.85, 0.85))]
    objects = _boxes(
        place,
        ((1.2, 2.0, 0.04), (1.05, 0.0, 0.7)),
        *legs,
        ((0.25, 0.25, 0.25), (0.75, random.uniform(0.35, 0.45), 0.85)),
        ((0.2, 0.02, 0.4), (1.05, -0.2, 0.9)),
        ((0.02, 0.2, 0.4), (0.65, 0.2, 0.9)),
        ((0.2, 0.05, 0.35), (0.65, -0.2, 0.9)),
        ((0.2, 0.05, 0.35), (1.05, 0.2, 0.9)),
    )
    can = (random.uniform(0.75, 0.85), random.uniform(-0.1, 0.1), 0.79)
    under = _at(random.uniform(0.45, 0.6), random.uniform(-0.2, 0.2), random.uniform(0.35, 0.5))
    return (*objects, _can(place, "can", *can)), under, _at(can[0], can[1], can[2] + 0.03)


_SCENES = {
    "cage": _cage,
    "bookshelf_tall": _bookshelf_tall,
    "bookshelf_thin": _bookshelf_thin,
    "table_under_pick": _table_under_pick,
}
