"""Depth cameras that see a robot with mass among things: motions avoid what they see, and stop for what comes in."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from ctypes.util import find_library
from pathlib import Path

import numpy as np
import pytest

import zarm
from support.harness import ServiceProcess, eventually, router
from zarm_contract.keys import Keys
from zarm_contract.messages import Camera, Cuboid, LoadWorld, PerceptionState
from zarm_contract.robot import load_robot
from zarm_geometry import rows
from zarm_geometry.frames import pose_of
from zarm_geometry.robot_model import RobotModel
from zarm_geometry.voxel_blocks import VoxelBlocks
from zarm_perception.robot_shape import RobotShapes
from zarm_runtime.bus import Bus

UR5E = load_robot("ur5e")
MODEL = RobotModel.of(UR5E)
THERE = (-0.5, -1.57, 1.57, -1.57, -1.57, 0.0)
BACK = (0.9, -1.57, 1.57, -1.57, -1.57, 0.0)
FLOOR = Cuboid(kind="cuboid", name="floor", position=(0.0, 0.0, -0.3), size=(4.0, 4.0, 0.02))
POST = Cuboid(kind="cuboid", name="post", position=(0.55, 0.1, 0.3), size=(0.08, 0.08, 0.7))

pytestmark = pytest.mark.skipif(
    not (find_library("EGL") or find_library("OSMesa") or "MUJOCO_GL" in os.environ), reason="nothing renders here"
)


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

    def __init__(self, stack: ExitStack, folder: Path) -> None:
        self.endpoint = stack.enter_context(router())
        self.bus = stack.enter_context(Bus(self.endpoint))
        self.keys = Keys("ur5e")
        self.blocks = VoxelBlocks()
        self.stack, self.folder = stack, folder
        self.processes: dict[str, ServiceProcess] = {}
        started = {
            "physics_sim": ("--drives", "ideal"),
            "perception": (),
            "planner": (),
            "servo": (),
            "executor": ("--strategy", "joint_trajectory"),
        }
        for service, arguments in started.items():
            self.processes[service] = self.begin(service, *arguments)
        self.bus.watch(self.keys.voxels("*"), self.blocks.receive)
        self.robot = stack.enter_context(zarm.connect(self.endpoint))

    def begin(self, service: str, *arguments: str) -> ServiceProcess:
        """Start a service, and wait until it is ready."""
        process = ServiceProcess(service, self.endpoint, self.folder, "ur5e", arguments=arguments)
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
def cell_of(folder: Path) -> Iterator[Cell]:
    with ExitStack() as stack:
        yield Cell(stack, folder)


def planned(cell: Cell) -> bool:
    """Whether a motion is planned."""
    try:
        return bool(cell.robot.plan(BACK, start=THERE))
    except zarm.Unavailable:
        return False


def test_what_cameras_see_is_avoided_and_the_robot_is_not_in_its_own_way(tmp_path: Path) -> None:
    with cell_of(tmp_path) as cell:
        cell.world(FLOOR, POST)
        state = cell.look(FRONT, SIDE)
        assert not state.stale
        assert all(one.robot > 0.005 for one in state.cameras)
        off = rows.distances(cell.points, rows.primitives([FLOOR, POST])).min(axis=1)
        assert off.max() < 0.02, "nothing is seen that is not there"
        for goal in (BACK, THERE, BACK):
            plan = cell.robot.plan(goal)
            assert plan.clearance > 0.0
            cell.robot.execute(plan)
            touched = cell.robot.simulation.state().contacts
            assert not [one for one in touched if {one.first, one.second} & {*UR5E.descriptor.collision}]
        cell.images(3)
        joints = np.array(cell.robot.joint_state().position)
        robot = RobotShapes(MODEL).at(joints).parts
        assert rows.distances(cell.points, robot).min() > 0.01, "its own motion has left nothing in the map"


def test_a_motion_stops_for_what_comes_in_and_goes_on_when_it_has_gone(tmp_path: Path) -> None:
    with cell_of(tmp_path) as cell:
        cell.world(FLOOR)
        cell.look(FRONT, SIDE)
        cell.robot.execute(cell.robot.plan(BACK))
        goal = cell.robot.start(cell.robot.plan(THERE, velocity_scale=0.15))
        cell.world(FLOOR, POST)
        held = next(state.hold for state in cell.robot.goal_states(goal) if state.hold is not None)
        assert held.obstruction is not None
        assert held.obstruction.object.startswith("map.")
        cell.world(FLOOR)
        assert cell.robot.follow(goal).done
        assert cell.robot.joint_state().position == pytest.approx(THERE, abs=0.02)
        touched = {name for one in cell.robot.simulation.state().contacts for name in (one.first, one.second)}
        assert not touched & {*UR5E.descriptor.collision}


def test_a_camera_that_does_not_see_is_said_and_the_map_stays(tmp_path: Path) -> None:
    with cell_of(tmp_path) as cell:
        cell.world(FLOOR, POST)
        cell.look(FRONT)
        before = len(cell.points)
        assert before > 100
        cell.processes["physics_sim"].kill()
        stale = cell.robot.perception.state
        eventually(lambda: "no image for" in stale().cameras[0].problem, "it is said that the camera does not see")
        assert stale().stale
        assert len(cell.points) > 0.9 * before
        with pytest.raises(zarm.Unavailable, match="the voxel map is stale: front: no image for"):
            cell.robot.plan(BACK, start=THERE)
        cell.robot.perception.publish("front", time.time() + 0.5, bytes(2 * 320 * 240), width=320, height=240)
        eventually(lambda: "in the future" in stale().cameras[0].problem, "the clock is wrong")
        with pytest.raises(zarm.InvalidRequest, match="there is no camera middle; there are"):
            cell.robot.perception.remove("middle")
        with pytest.raises(zarm.InvalidRequest, match="the robot has no link elbow"):
            cell.robot.perception.add(FRONT.model_copy(update={"link": "elbow"}))
        cell.robot.perception.remove("front")
        cell.robot.perception.clear()
        eventually(lambda: len(cell.points) == 0, "the map is empty")
        eventually(lambda: not stale().stale, "nobody misses a camera")
        eventually(lambda: planned(cell), "it plans again")
        cell.processes["perception"].kill()
        eventually(lambda: not planned(cell), "the perception has gone")


def test_a_perception_that_begins_again_frees_what_has_gone_meanwhile(tmp_path: Path) -> None:
    with cell_of(tmp_path) as cell:
        cell.world(FLOOR, POST)
        cell.look(FRONT)

        def at_the_post() -> int:
            return int((rows.distances(cell.points, rows.primitives([POST]))[:, 0] < 0.02).sum())

        assert at_the_post() > 50
        cell.processes["perception"].kill()
        cell.world(FLOOR)
        cell.begin("perception")
        assert at_the_post() > 50, "it has seen nothing yet, and what was seen stays"
        cell.robot.perception.add(FRONT)
        eventually(lambda: at_the_post() == 0, "the camera sees that it has gone")


def test_a_camera_on_the_wrist_sees_the_same_world_from_everywhere(tmp_path: Path) -> None:
    with cell_of(tmp_path) as cell:
        low = Cuboid(kind="cuboid", name="low", position=(0.5, 0.1, -0.22), size=(0.15, 0.15, 0.14))
        cell.world(FLOOR, low)
        wrist = camera("wrist", (0.08, 0.0, 0.02), (0.08, 0.001, 1.0), link=UR5E.descriptor.tip_link)
        cell.look(wrist)
        for goal in (BACK, THERE):
            cell.robot.execute(cell.robot.plan(goal))
        cell.images(3)
        off = rows.distances(cell.points, rows.primitives([FLOOR, low])).min(axis=1)
        assert len(off) > 150
        assert np.quantile(off, 0.98) < 0.02
