"""Depth cameras that see a robot with mass among things: motions avoid what they see, and stop for what comes in."""

from __future__ import annotations

import os
import shutil
import time
from collections.abc import Iterator
from contextlib import ExitStack
from ctypes.util import find_library
from pathlib import Path

import numpy as np
import pytest

import zarm
from support.example_programs import run_example
from support.harness import ServiceProcess, eventually, router
from support.seeing_cell import BACK, FLOOR, FRONT, MODEL, POST, SIDE, THERE, UR5E, Cell, camera, cell_of
from zarm_contract.image import OF_ROBOT, decode_color
from zarm_contract.keys import Keys
from zarm_contract.messages import Camera, Cuboid
from zarm_contract.robot import ROBOTS
from zarm_geometry import packed_shapes
from zarm_perception.robot_shape import RobotShapes
from zarm_runtime.bus import Bus

pytestmark = pytest.mark.skipif(
    not (find_library("EGL") or find_library("OSMesa") or "MUJOCO_GL" in os.environ), reason="nothing renders here"
)


def planned(cell: Cell) -> bool:
    """Whether a motion is planned."""
    try:
        return bool(cell.robot.plan(BACK, start=THERE))
    except zarm.Unavailable:
        return False


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
        with pytest.raises(zarm.Unavailable, match="there is no camera; add one first"):
            cell.robot.perception.look(timeout=1.5)
        assert cell.robot.perception.boxes() == []
        cell.robot.perception.add(FRONT)
        with pytest.raises(zarm.Unavailable, match="the camera front has not given 5 images in 2 s"):
            cell.robot.perception.look(timeout=2.0)
        cell.robot.perception.remove("front")
        eventually(lambda: planned(cell), "it plans again")
        cell.processes["perception"].kill()
        eventually(lambda: not planned(cell), "the perception has gone")


def test_a_robot_that_is_to_be_slow_in_a_stale_map_is_slow(tmp_path: Path) -> None:
    shutil.copy(ROBOTS / "ur5e.urdf", tmp_path)
    text = (ROBOTS / "ur5e.yaml").read_text(encoding="utf-8")
    (tmp_path / "slow.yaml").write_text(text + "\nstale_map: slow\n", encoding="utf-8")
    with ExitStack() as stack:
        endpoint = stack.enter_context(router())
        bus = stack.enter_context(Bus(endpoint))
        processes = {}
        for service in ("perception", "planner"):
            process = ServiceProcess(service, endpoint, tmp_path, str(tmp_path / "slow.yaml"))
            processes[service] = stack.enter_context(process)
            process.wait_ready(bus, Keys("ur5e"))
        robot = stack.enter_context(zarm.connect(endpoint))
        quick = robot.plan(BACK, start=THERE).trajectory.time[-1]
        robot.perception.add(FRONT)
        eventually(lambda: robot.perception.state().stale, "the camera gives no images")
        eventually(lambda: robot.plan(BACK, start=THERE).trajectory.time[-1] > 4.0 * quick, "plans are slow")
        robot.perception.remove("front")
        eventually(lambda: robot.plan(BACK, start=THERE).trajectory.time[-1] < 1.5 * quick, "plans are quick again")


def test_a_restarted_perception_frees_what_has_gone(tmp_path: Path) -> None:
    with cell_of(tmp_path) as cell:
        cell.world(FLOOR, POST)
        cell.look(FRONT)

        def at_the_post() -> int:
            return int((packed_shapes.distances(cell.points, packed_shapes.primitives([POST]))[:, 0] < 0.02).sum())

        assert at_the_post() > 50
        cell.processes["perception"].kill()
        cell.world(FLOOR)
        cell.processes["perception"] = cell.begin("perception")
        assert at_the_post() > 50, "it has seen nothing yet, and what was seen stays"
        cell.robot.perception.add(FRONT)
        eventually(lambda: at_the_post() == 0, "the camera sees that it has gone")
        cell.world(FLOOR, POST)
        eventually(lambda: at_the_post() > 50, "it is back")
        cell.processes["perception"].kill()
        cell.begin("perception", "--box", "0.2,-1,-0.25,1,1,1.25")
        eventually(lambda: at_the_post() == 0, "the blocks of a map with another box are forgotten")


BLOCKS = {"block_0": (0.04, 0.04, 0.04), "block_1": (0.04, 0.07, 0.05), "block_2": (0.05, 0.04, 0.04), "block_3": (0.04, 0.04, 0.06)}  # fmt: skip
LONGEST = 300.0


@pytest.mark.timeout(LONGEST + 60.0)
def test_the_example_picks_from_a_camera_image_into_the_tray(tmp_path: Path) -> None:
    fine = ("--box=0.2,-0.5,0.015,0.8,0.6,0.6", "--resolution", "0.01")
    with cell_of(tmp_path, "panda", "blocks", fine) as cell:
        seen = camera("front", (1.1, -0.25, 0.75), (0.45, 0.0, 0.0))
        cell.robot.perception.add(seen.model_copy(update={"fx": 320.0, "fy": 320.0}))
        cell.robot.perception.look()
        bodies = {body.name: body for body in cell.robot.simulation.state().bodies}
        boxes = cell.robot.perception.boxes(floor=0.0)
        assert len(boxes) == len(BLOCKS)
        for name, size in BLOCKS.items():
            box = min(boxes, key=lambda one: np.hypot(*np.subtract(one.position, bodies[name].position)[:2]))
            assert box.position == pytest.approx(bodies[name].position, abs=0.01)
            assert sorted(box.size) == pytest.approx(sorted(size), abs=0.025)
        cell.robot.perception.remove("front")
        said = run_example("16_pick_what_a_camera_sees", cell.endpoint, LONGEST)
        assert said.startswith("the camera sees 4 blocks\n")
        for body in cell.robot.simulation.state().bodies:
            assert 0.3 < body.position[0] < 0.6
            assert 0.18 < body.position[1] < 0.48
            assert 0.025 < body.position[2] < 0.045, "it stands in the tray"


@pytest.fixture(scope="module")
def shared(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cell]:
    with cell_of(tmp_path_factory.mktemp("cell")) as cell:
        yield cell


@pytest.fixture
def cell(shared: Cell) -> Cell:
    """One for tests that end no process, with the robot at home, without cameras and an empty map."""
    for one in shared.robot.perception.state().cameras:
        shared.robot.perception.remove(one.name)
    shared.robot.perception.clear()
    eventually(lambda: len(shared.points) == 0 and planned(shared), "the map is empty")
    shared.robot.execute(shared.robot.plan(UR5E.descriptor.home))
    return shared


def test_what_cameras_see_is_avoided_except_the_robot_itself(cell: Cell) -> None:
    cell.world(FLOOR, POST)
    state = cell.look(FRONT, SIDE)
    assert not state.stale
    assert all(one.robot > 0.005 for one in state.cameras)
    masks: list[bytes] = []
    cell.bus.listen(cell.keys.mask("front"), lambda _, payload: masks.append(payload))
    eventually(lambda: masks, "what the map makes of an image is published")
    header, pixels = decode_color(masks[0])
    assert np.mean(np.frombuffer(pixels, np.uint8) == OF_ROBOT) == pytest.approx(state.cameras[0].robot, rel=0.3)
    assert header.width == 160
    assert {*cell.robot.perception.points()} == {*map(tuple, cell.points.tolist())}
    off = packed_shapes.distances(cell.points, packed_shapes.primitives([FLOOR, POST])).min(axis=1)
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
    assert packed_shapes.distances(cell.points, robot).min() > 0.01, "its own motion has left nothing in the map"


def test_a_motion_stops_for_an_intruder_and_resumes(cell: Cell) -> None:
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


def test_a_wrist_camera_sees_the_same_world_from_everywhere(cell: Cell) -> None:
    low = Cuboid(kind="cuboid", name="low", position=(0.5, 0.1, -0.22), size=(0.15, 0.15, 0.14))
    cell.world(FLOOR, low)
    wrist = camera("wrist", (0.08, 0.0, 0.02), (0.08, 0.001, 1.0), link=UR5E.descriptor.tip_link)
    cell.look(wrist)
    for goal in (BACK, THERE):
        cell.robot.execute(cell.robot.plan(goal))
    cell.images(3)
    off = packed_shapes.distances(cell.points, packed_shapes.primitives([FLOOR, low])).min(axis=1)
    assert len(off) > 150
    assert np.quantile(off, 0.98) < 0.02


def test_a_lidar_makes_the_same_map_which_is_saved_and_loaded(cell: Cell, tmp_path: Path) -> None:
    cell.world(FLOOR, POST)
    per = 360 / (2.0 * np.pi)
    lidar = Camera(
        name="top", position=(1.0, 0.9, 0.7), projection="spherical",
        width=360, height=64, fx=per, fy=per, cx=179.5, cy=20.0, far=5.0,
    )  # fmt: skip
    state = cell.look(lidar)
    assert 0.005 < state.cameras[0].robot < 0.5
    off = packed_shapes.distances(cell.points, packed_shapes.primitives([FLOOR, POST])).min(axis=1)
    assert off.max() < 0.02, "nothing is seen that is not there, the robot is not either"
    cell.robot.perception.remove("top")
    before = {*cell.robot.perception.points()}
    cell.robot.perception.save(tmp_path / "cell.map")
    cell.robot.perception.clear()
    eventually(lambda: len(cell.points) == 0, "the map is empty")
    loaded = cell.robot.perception.load(tmp_path / "cell.map")
    assert (loaded.occupied, loaded.outside) == (len(before), 0)
    assert {*cell.robot.perception.points()} == before
    with pytest.raises(zarm.InvalidRequest, match="name a file that was saved"):
        cell.robot.perception.load(tmp_path / "another.map")
    (tmp_path / "another.map").write_text("position: [0, 0, 1]")
    with pytest.raises(zarm.InvalidRequest, match="is no saved map"):
        cell.robot.perception.load(tmp_path / "another.map")
    assert (packed_shapes.distances(np.array([*before]), packed_shapes.primitives([POST]))[:, 0] < 0.02).sum() > 20
