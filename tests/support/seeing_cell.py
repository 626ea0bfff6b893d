"""A robot with mass among things that only its cameras see: physics, perception, planner, servo and executor."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path

import numpy as np

import zarm
from support.harness import ServiceProcess, eventually, router
from zarm_contract.keys import Keys
from zarm_contract.messages import Camera, Cuboid, LoadWorld, PerceptionState
from zarm_contract.robot import load_robot
from zarm_geometry.frames import pose_of
from zarm_geometry.robot_model import RobotModel
from zarm_geometry.voxel_blocks import VoxelBlocks
from zarm_runtime.bus import Bus

UR5E = load_robot("ur5e")
MODEL = RobotModel.of(UR5E)
THERE = (-0.5, -1.57, 1.57, -1.57, -1.57, 0.0)
BACK = (0.9, -1.57, 1.57, -1.57, -1.57, 0.0)
FLOOR = Cuboid(kind="cuboid", name="floor", position=(0.0, 0.0, -0.3), size=(4.0, 4.0, 0.02))
POST = Cuboid(kind="cuboid", name="post", position=(0.55, 0.1, 0.3), size=(0.08, 0.08, 0.7))


def camera(
    name: str, eye: tuple[float, float, float], at: tuple[float, float, float], link: str | None = None
) -> Camera:
    z = np.subtract(at, eye) / np.linalg.norm(np.subtract(at, eye))
    x = np.cross(z, [0.0, 0.0, 1.0])
    x /= np.linalg.norm(x)
    pose = np.eye(4)
    pose[:3, :3] = np.column_stack((x, np.cross(z, x), z))
    return Camera(
        name=name, link=link, position=eye, orientation=pose_of(pose).orientation,
        width=320, height=240, fx=260.0, fy=260.0, cx=159.5, cy=119.5, far=5.0, rate=10.0,
    )  # fmt: skip


FRONT = camera("front", (1.7, -0.9, 1.2), (0.3, 0.0, 0.2))
SIDE = camera("side", (0.9, 1.6, 1.3), (0.3, 0.0, 0.2))


class Cell:
    """A robot with mass, its planner, servo, executor and perception, and what is published of the map."""

    def __init__(
        self,
        stack: ExitStack,
        folder: Path,
        name: str = "ur5e",
        world: str | None = None,
        perception: Sequence[str] = (),
    ) -> None:
        self.name = name
        self.endpoint = stack.enter_context(router())
        self.bus = stack.enter_context(Bus(self.endpoint))
        self.keys = Keys(name)
        self.blocks = VoxelBlocks()
        self.stack, self.folder = stack, folder
        self.processes: dict[str, ServiceProcess] = {}
        started: dict[str, Sequence[str]] = {
            "physics_sim": ("--drives", "ideal", *(() if world is None else ("--world", world))),
            "perception": perception,
            "planner": (),
            "servo": (),
            "executor": ("--strategy", "joint_trajectory"),
        }
        for service, arguments in started.items():
            self.processes[service] = self.begin(service, *arguments)
        self.bus.watch(self.keys.voxels("*"), self.blocks.receive)
        self.bus.watch(self.keys.perception_state, self.blocks.on_state)
        self.robot = stack.enter_context(zarm.connect(self.endpoint))

    def begin(self, service: str, *arguments: str) -> ServiceProcess:
        """Start a service, and wait until it is ready."""
        process = ServiceProcess(service, self.endpoint, self.folder, self.name, arguments=arguments)
        self.stack.enter_context(process).wait_ready(self.bus, self.keys)
        return process

    def world(self, *things: Cuboid) -> None:
        """What there is; the scene stays empty."""
        self.bus.call(self.keys.physics_world, LoadWorld(objects=things), timeout=10.0)

    def look(self, *cameras: Camera) -> PerceptionState:
        """Add cameras, and wait until each has given some images."""
        for one in cameras:
            self.robot.perception.add(one)
        return self.images(8)

    def images(self, count: int) -> PerceptionState:
        """Wait for as many more images of each camera."""
        before = {one.name: one.images for one in self.robot.perception.state().cameras}

        def enough() -> bool:
            state = self.robot.perception.state()
            return bool(state.cameras) and all(one.images >= before.get(one.name, 0) + count for one in state.cameras)

        eventually(enough, "the cameras see")
        return self.robot.perception.state()

    @property
    def points(self) -> np.ndarray:
        """The centres (n, 3) of the occupied voxels."""
        found = [np.array(item.cells) * item.resolution + item.position for item in self.blocks.objects.values()]
        return np.concatenate([np.empty((0, 3)), *found])


@contextmanager
def cell_of(
    folder: Path, name: str = "ur5e", world: str | None = None, perception: Sequence[str] = ()
) -> Iterator[Cell]:
    with ExitStack() as stack:
        yield Cell(stack, folder, name, world, perception)
