"""What the voxel map costs, and whether it can be trusted: `python tests/benchmarks/perception.py [--scenes 20] [--plans 50] [--cameras 4] [--unseen occupied]`.

An M1013 among random boxes, seen by two or more simulated cameras of 640 x 480 with the noise of a RealSense (quadratic in depth), holes and flying pixels. *Image*: CPU time to
take one into the map. *Planner*, *servo*: from its blocks to a scene that is ready for the next plan, and to a motion check that knows them; the first images of a scene, which change all
blocks, are counted apart. *Plan*: through the map, and
among the boxes themselves, problem by problem. Each plan through the map is then checked against the boxes as they are, and all are executed among them by the
robot with mass and `industrial` drives.
"""

from __future__ import annotations

import argparse
import logging
import os
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

from zarm_trajectory.arrays import Array

os.environ.setdefault("MUJOCO_GL", "egl")

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

from zarm_contract.errors import ZarmError
from zarm_contract.messages import Camera, Cuboid, JointGoal, LoadScene, Plan, PlanRequest, SceneEdit
from zarm_contract.robot import load_robot
from zarm_geometry.exact import ExactScene
from zarm_geometry.frames import pose_of
from zarm_geometry.meshes import Meshes
from zarm_geometry.robot_model import RobotModel
from zarm_geometry.voxel_blocks import VoxelBlocks
from zarm_geometry.world import World
from zarm_perception.blocks import Blocks
from zarm_perception.cameras import CameraSource
from zarm_perception.robot_shape import RobotShapes
from zarm_perception.voxel_map import VoxelMap
from zarm_physics_sim.cameras import CameraRenderer
from zarm_physics_sim.drives import PRESETS, Drives
from zarm_physics_sim.simulation import STEP, Simulation
from zarm_physics_sim.world import World as PhysicalWorld
from zarm_planner.handlers import Handlers
from zarm_planner.scene.store import SceneStore
from zarm_servo.world.check import SceneCheck
from zarm_trajectory.trajectory import TimedTrajectory

ROBOT = load_robot("doosan_m1013")
MODEL = RobotModel.of(ROBOT)
HOME = np.array(ROBOT.descriptor.home)
ALONE = ExactScene(MODEL, World([], 0.0)).nearest(HOME[None]).distance
"""How near the robot is to itself at home (m)."""
PADDING = 0.03
BOX = np.array((-1.0, -1.0, -0.25)), np.array((1.0, 1.0, 1.25))
FLOOR = Cuboid(kind="cuboid", name="floor", position=(0.0, 0.0, -0.06), size=(5.0, 5.0, 0.1))


def camera(name: str, eye: tuple[float, float, float], at: tuple[float, float, float]) -> Camera:
    pose = np.eye(4)
    z = np.subtract(at, eye) / np.linalg.norm(np.subtract(at, eye))
    x = np.cross(z, [0.0, 0.0, 1.0])
    x /= np.linalg.norm(x)
    pose[:3, :3] = np.column_stack((x, np.cross(z, x), z))
    return Camera(
        name=name, position=eye, orientation=pose_of(pose).orientation, width=640, height=480, fx=460.0, fy=460.0, cx=319.5, cy=239.5
    )  # fmt: skip


CAMERAS = (
    camera("front", (2.0, -1.0, 1.5), (0.2, 0.0, 0.3)),
    camera("back", (-0.9, 1.7, 1.7), (0.2, 0.0, 0.3)),
    camera("left", (1.6, 1.5, 0.15), (0.0, 0.0, 0.4)),
    camera("right", (-1.6, -1.5, 0.15), (0.0, 0.0, 0.4)),
)
"""Two from above; the others, from near the floor, see the undersides and what is behind."""


def clutter(rng: np.random.Generator) -> list[Cuboid]:
    """Boxes that leave the robot room at home."""
    scene: list[Cuboid] = [FLOOR]
    while len(scene) < 9:
        size = rng.uniform(0.05, 0.3, 3)
        place = (*rng.uniform(-0.8, 0.8, 2), size[2] / 2 - 0.01 + rng.choice([0.0, rng.uniform(0.0, 0.6)]))
        box = Cuboid(
            kind="cuboid", name=f"box{len(scene)}", position=tuple(map(float, place)), size=tuple(size.tolist())
        )
        if ExactScene(MODEL, World([box], 0.0)).nearest(HOME[None]).distance > 0.9 * ALONE:
            scene.append(box)
    return scene


def noisy(depth: NDArray[np.uint16], rng: np.random.Generator) -> NDArray[np.float32]:
    """An image (h, w) in m as a stereo camera gives it."""
    z = depth.astype(np.float32) * 0.001
    z += (0.0015 * z * z * rng.standard_normal(z.shape)).astype(np.float32)
    edge = np.abs(np.diff(z, axis=1, append=z[:, -1:])) > 0.05
    flying = edge & (rng.random(z.shape) < 0.5)
    z = np.where(flying, 0.5 * (z + np.roll(z, -1, axis=1)), z)
    z[rng.random(z.shape) < 0.01] = 0.0
    return np.ascontiguousarray(z, np.float32)


def planned(handlers: Handlers, goal: Array) -> tuple[Plan | None, float]:
    began = time.perf_counter()
    try:
        plan = handlers.plan(PlanRequest(goal=JointGoal(kind="joints", position=tuple(goal.tolist())), start=tuple(HOME.tolist()), optimize_s=0.0, timeout=2.0))  # fmt: skip
    except ZarmError:
        plan = None
    return plan, time.perf_counter() - began


def collisions(simulation: Simulation, motion: TimedTrajectory) -> set[str]:
    """What the robot touches while it executes a motion, and half a second later."""
    drives, touched = Drives(PRESETS["industrial"], simulation.limit, STEP, np.random.default_rng(0)), set()
    simulation.place(HOME)
    times = np.minimum(np.arange(0.0, motion.duration + 0.5, STEP), motion.duration)
    for reference in zip(*(motion.sample(times)), strict=True):
        measured = drives.measured(simulation.position, simulation.velocity)
        simulation.step(drives.torque(reference, measured, simulation.mass, simulation.bias), np.empty(0))
        for contact in simulation.contacts():
            touched |= {contact.first, contact.second} - {*ROBOT.descriptor.collision}
    return touched


def spread(values: Sequence[float] | Array) -> tuple[float, float, float]:
    """Median, 95 % and largest."""
    return float(np.median(values)), float(np.percentile(values, 95)), float(np.max(values))


def main() -> None:
    """Print the tables."""
    logging.disable()
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenes", type=int, default=20)
    parser.add_argument("--plans", type=int, default=50, help="of each scene")
    parser.add_argument("--cameras", type=int, default=2, help="how many of the four see the scene")
    parser.add_argument("--unseen", choices=("free", "occupied"), default="free", help="what no camera has seen is")
    arguments = parser.parse_args()
    rng, robot = np.random.default_rng(0), RobotShapes(MODEL)
    cameras = CAMERAS[: arguments.cameras]
    sources = [CameraSource(one, MODEL) for one in cameras]
    image, pairs = [], []
    first: list[tuple[float, float, int]] = []
    later: list[tuple[float, float, int]] = []
    solved, touched, hit, nearest = [0, 0], 0, [0, 0], np.inf
    with tempfile.TemporaryDirectory() as folder:
        seeing, knowing = (
            Handlers(MODEL, "m1013", SceneStore(Path(folder, name)), lambda: HOME) for name in ("map", "boxes")
        )
        seeing.warm_up(lambda _: None)
        for _ in range(arguments.scenes):
            things = clutter(rng)
            simulation = Simulation(ROBOT, PhysicalWorld({item.name: item for item in things}), HOME)
            renderer = CameraRenderer(simulation, 640, 480)
            voxels, store, check = (
                VoxelMap(*BOX, 0.02, unseen_occupied=arguments.unseen == "occupied"),
                VoxelBlocks(),
                SceneCheck(MODEL, Meshes()),
            )
            seeing.scenes.voxels, blocks = store, Blocks(voxels)
            for number in range(8):
                for one, source in zip(cameras, sources, strict=True):
                    depth = noisy(renderer.depth(one, one.intrinsics, simulation.snapshot()), rng)
                    began = time.process_time()
                    voxels.integrate(depth, source.view(HOME), robot.at(HOME), PADDING)
                    took = time.process_time() - began
                    changes = [*blocks.changed()]
                    image.append(took)
                    began = time.perf_counter()
                    for name, block in changes:
                        store.receive(f"map/{name}", block)
                    known = time.perf_counter()
                    seeing.scenes.present(0.01)
                    ready = time.perf_counter()
                    check.load(dict(store.objects))
                    loaded = time.perf_counter() - ready
                    timed = (ready - began, loaded + known - began, len(changes))
                    (later if number else first).append(timed)
            renderer.close()
            knowing.edit(SceneEdit(edit=LoadScene(op="load", objects=tuple(things))))
            truth = ExactScene(MODEL, World(things, 0.0))
            for _ in range(arguments.plans):
                goal = rng.uniform(np.maximum(MODEL.lower, -2.0), np.minimum(MODEL.upper, 2.0))
                if truth.nearest(goal[None]).distance < 0.01:
                    continue
                for _ in range(
                    2
                ):  # whoever plans to a goal first fills the caches for the other, so the second time counts
                    (through, quick), (among, took) = planned(seeing, goal), planned(knowing, goal)
                solved[0] += through is not None
                solved[1] += among is not None
                if among is not None:
                    hit[1] += bool(
                        collisions(simulation, TimedTrajectory.of(among.trajectory, ROBOT.descriptor.joints))
                    )
                if through is not None:
                    motion = TimedTrajectory.of(through.trajectory, ROBOT.descriptor.joints)
                    least = truth.nearest(motion.positions(np.arange(0.0, motion.duration, 0.002))).distance
                    touched += least <= 0.0
                    hit[0] += bool(collisions(simulation, motion))
                    nearest = min(nearest, least)
                    if among is not None:
                        pairs.append((quick, took))
    console, ms = Console(width=160), 1e3
    table = Table("", "median", "p95", "max")
    table.add_row("image, CPU ms", *(f"{ms * value:.1f}" for value in spread(image)))
    for which, rows in (("", later), (", first images", first)):
        to_planner, to_servo, changed = np.array(rows).T
        table.add_row(f"planner, ms{which}", *(f"{ms * value:.1f}" for value in spread(to_planner)))
        table.add_row(f"servo, ms{which}", *(f"{ms * value:.1f}" for value in spread(to_servo)))
        table.add_row(f"blocks that change{which}", *(f"{value:.0f}" for value in spread(changed)))
    console.print(table)
    quick, took = np.array(pairs or [(np.nan, np.nan)]).T
    table = Table(
        "plans",
        "solved: map, boxes",
        "plan ms, map / boxes",
        "that touch a box",
        "in physics: map, boxes",
        "nearest, mm",
    )
    table.add_row(
        f"{len(pairs)}", f"{solved[0]}, {solved[1]}",
        f"{ms * np.median(quick):.1f} / {ms * np.median(took):.1f}; {np.median(quick / took):.2f}", f"{touched}", f"{hit[0]}, {hit[1]}", f"{ms * nearest:.1f}",
    )  # fmt: skip
    console.print(table)


if __name__ == "__main__":
    main()
