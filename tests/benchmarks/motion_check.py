"""What the check of motions costs: `python tests/benchmarks/motion_check.py [--motions 60] [--most 10000]`.

Motions of 1 s of the M1013, sampled every 4 ms, among cubes of 1 to 3 cm within its reach, which are everywhere or keep 3 cm
from the motion, and over a floor of 1e5 voxels. In the same run, with the same motions: the exact check of the planner, which looks
every 5 mm; so `to exact` is what the check saves. Also what it costs to change one object, against a new world; and how often it is
too careful: a motion is called not free, though the exact check finds that it keeps the margin.

Times are CPU times of one thread, the best of three. Prints tables of ratios and times.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from typing import TypeVar

import numpy as np
from rich.console import Console
from rich.table import Table

from zarm_contract.messages import Cuboid, SceneObject, Voxels
from zarm_contract.robot import load_robot
from zarm_geometry.exact import RESOLUTION, ExactScene
from zarm_geometry.motion_check import MotionCheck
from zarm_geometry.robot_model import RobotModel
from zarm_geometry.world import World
from zarm_trajectory.arrays import Array

T = TypeVar("T")

MARGIN = 0.005
TIMES = np.arange(0.0, 1.0001, 0.004)
COUNTS = (10, 100, 1000, 10_000)
VOXELS = 100_000
CLEAR = 0.03
"""Metres that cubes keep from a motion that they leave free."""
_REST_TO_REST = TIMES**3 * (10 - 15 * TIMES + 6 * TIMES**2)


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--motions", type=int, default=60, help="motions per row")
    parser.add_argument("--most", type=int, default=COUNTS[-1], help="objects at most")
    options = parser.parse_args()
    model = RobotModel.of(load_robot("doosan_m1013"))
    rng = np.random.default_rng(0)
    motions = [motion(model, rng) for _ in range(options.motions)]
    console = Console(width=140)
    table = Table(
        "world", "check ms", "p95 ms", "exact ms", "to exact", "free", "too careful", "new world ms", "one object ms"
    )
    for count in (count for count in COUNTS if count <= options.most):
        for what, off in (("everywhere", False), ("off the motion", True)):
            worlds = [cubes(model, one, count, rng, off=off) for one in motions[: len(motions) if off else 1]]
            table.add_row(f"{count} cubes {what}", *row(model, motions, worlds))
            console.print(f"{count} cubes {what}: done")
    table.add_row(f"{VOXELS} voxels", *row(model, motions, [[floor(rng)]]))
    console.print(table)


def motion(model: RobotModel, rng: np.random.Generator) -> Array:
    """Rest to rest in 1 s, at up to 1.2 rad/s, free of the robot itself."""
    alone = ExactScene(model, World((), 0.0))
    while True:
        start = rng.uniform(np.maximum(model.lower, -2.5), np.minimum(model.upper, 2.5))
        found = start + np.outer(_REST_TO_REST, rng.uniform(-0.64, 0.64, model.dof))
        if alone.nearest(found[::10]).distance > 2 * MARGIN:
            return found


def cubes(model: RobotModel, path: Array, count: int, rng: np.random.Generator, *, off: bool) -> list[SceneObject]:
    """Cubes of 1 to 3 cm within reach of the robot and not in its base, anywhere or `off` a motion."""
    reach = float(ExactScene(model, World((), 0.0)).reach[0])
    frames = model.link_transforms(path[::10])
    arm = [((frames[:, link] @ shape.pose)[:, :3, 3], shape.radius) for link, shape in model.parts]
    centers, sizes = np.empty((0, 3)), rng.uniform(0.01, 0.03, count)
    while len(centers) < count:
        more = rng.uniform(-reach, reach, (4096, 3))
        away = np.linalg.norm(more, axis=1)
        keep = (away < reach) & (away > 0.3)
        if off:
            for places, radius in arm:
                nearest = np.linalg.norm(more[:, None] - places, axis=2).min(axis=1)
                keep &= nearest > radius + 0.015 * np.sqrt(3) + CLEAR + 0.03  # and what it moves between the places
        centers = np.vstack((centers, more[keep]))
    return [
        Cuboid(kind="cuboid", name=f"cube{i}", position=tuple(center), size=(size, size, size))
        for i, (center, size) in enumerate(zip(centers.tolist(), sizes.tolist(), strict=False))
    ]


def floor(rng: np.random.Generator) -> SceneObject:
    """A rough floor of VOXELS cells of 1 cm below the robot's base."""
    side = int(np.ceil(np.sqrt(VOXELS)))
    x, y = (axis.ravel()[:VOXELS] - side // 2 for axis in np.indices((side, side)))
    cells = np.column_stack([x, y, rng.integers(-8, -2, VOXELS)])
    return Voxels(kind="voxels", name="floor", resolution=0.01, cells=tuple(map(tuple, cells.tolist())))


def row(model: RobotModel, motions: list[Array], scenes: list[list[SceneObject]]) -> list[str]:
    """A row of the table for motions, each in its own scene or all in one."""
    check = MotionCheck(model)
    limits = np.full(model.dof, 6.0)
    took, exactly, free, careful = [], [], [], 0
    for number, path in enumerate(motions):
        if number < len(scenes):
            world = World(scenes[number], MARGIN)
            exact = ExactScene(model, world)
            check.set_world(world)
        verdict, seconds = timed(lambda path=path: check.check(TIMES, path, margin=MARGIN, acceleration=limits))
        pieces = int(np.ceil((np.abs(np.diff(path, axis=0)) @ exact.reach).sum() / RESOLUTION)) + 1
        dense = path[0] + (path[-1] - path[0]) * np.interp(np.linspace(0, 1, pieces), TIMES, _REST_TO_REST)[:, None]
        nearest, exact_seconds = timed(lambda dense=dense, exact=exact: exact.nearest(dense))
        took.append(seconds)
        exactly.append(exact_seconds)
        free.append(verdict.free)
        careful += not verdict.free and nearest.distance >= MARGIN
    objects = scenes[-1]
    _, anew = timed(lambda: check.set_world(World(objects, MARGIN)))
    _, one = timed(lambda: check.update(objects[:1]))
    ratio = np.median(np.array(exactly) / np.array(took))
    return [
        *(f"{1e3 * value:.3f}" for value in (np.median(took), np.percentile(took, 95), np.median(exactly))),
        f"{ratio:.1f} times",
        f"{sum(free)} of {len(free)}",
        f"{careful}",
        *(f"{1e3 * value:.2f}" for value in (anew, one)),
    ]


def timed(function: Callable[[], T]) -> tuple[T, float]:
    """What a function returns, and the CPU seconds that it takes, the best of three."""
    best = np.inf
    for _ in range(3):
        began = time.thread_time()
        result = function()
        best = min(best, time.thread_time() - began)
    return result, best


if __name__ == "__main__":
    main()
