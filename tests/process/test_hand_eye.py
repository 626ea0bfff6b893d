"""Cameras are found where they are, in hand and beside the robot, by a board that they see while the robot moves."""

from __future__ import annotations

import base64
import math
import os
from collections.abc import Iterator
from contextlib import ExitStack
from ctypes.util import find_library
from pathlib import Path

import numpy as np
import pytest
import yaml

import zarm
from support.board_painter import image_of, painted
from support.command_line import zarm as run_zarm
from support.harness import ServiceProcess, eventually, router
from support.seeing_cell import MODEL, Cell, cell_of
from zarm.robot import Robot
from zarm_contract.keys import Keys
from zarm_contract.messages import Camera, Cuboid, DynamicObject, Intrinsics, LoadWorld, Plan, Texture
from zarm_geometry.frames import matrix, pose_of
from zarm_hand_eye import Board, calibrate
from zarm_runtime.bus import Bus
from zarm_trajectory.arrays import Array

SIZE = Intrinsics(640, 480, 600.0, 600.0, 319.5, 239.5)
PIXELS = SIZE._asdict()
ABOVE = (0.0, -1.85, 1.85, -1.57, -1.57, 0.0)
"""Joints of a UR5e whose flange looks down at a board in front of it."""
BOARD = Board()
IN_HAND = matrix((0.05, -0.02, 0.03), (0.0, 0.0, math.sin(0.2), math.cos(0.2)))
"""A camera on the flange."""
ON_FLOOR = matrix((0.235, 0.233, 0.0), (1.0, 0.0, 0.0, 0.0))
"""A board below the flange; its z points into the floor."""


def off(frame: Array) -> Camera:
    """A camera that is declared 2 cm and 3 degrees off."""
    wrong = frame @ matrix((0.012, -0.012, 0.01), (0.02, 0.016, 0.0, math.sqrt(1.0 - 0.02**2 - 0.016**2)))
    pose = pose_of(wrong)
    return Camera(name="eye", position=pose.position, orientation=pose.orientation, **PIXELS)


def assert_found(camera: Camera, frame: Array) -> None:
    """It is where it should be, within 1 mm and 0.1 degrees."""
    found = matrix(camera.position, camera.orientation)
    assert np.linalg.norm(found[:3, 3] - frame[:3, 3]) < 1e-3
    turn = found[:3, :3].T @ frame[:3, :3]
    assert np.linalg.norm(turn - turn.T) / math.sqrt(8.0) < math.radians(0.1)


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Robot]:
    """An emulated UR5e with perception, above the board."""
    folder = tmp_path_factory.mktemp("hand_eye")
    with ExitStack() as stack:
        endpoint = stack.enter_context(router())
        bus = stack.enter_context(Bus(endpoint))
        for service in ("planner", "executor", "perception"):
            process = stack.enter_context(ServiceProcess(service, endpoint, folder, "ur5e"))
            process.wait_ready(bus, Keys("ur5e"))
        yield stack.enter_context(zarm.connect(endpoint))


@pytest.fixture(autouse=True)
def above(robot: Robot) -> None:
    """Without cameras, over the board."""
    for camera in robot.perception.cameras():
        robot.perception.remove(camera.name)
    eventually(lambda: not robot.perception.state().stale, "no camera is missed")
    robot.execute(eventually(lambda: planned(robot), "it plans again"))


def planned(robot: Robot) -> Plan | None:
    try:
        return robot.plan(ABOVE)
    except zarm.Unavailable:
        return None


def test_a_camera_in_hand_is_found_where_it_is(robot: Robot, tmp_path: Path) -> None:
    robot.perception.add(off(IN_HAND).model_copy(update={"link": "tool0"}))
    endpoint, file = robot.connection.bus.endpoint, tmp_path / "eye.yaml"
    with painted(robot, "eye", lambda q: image_of(BOARD, SIZE, np.linalg.inv(MODEL.fk_tip(q) @ IN_HAND) @ ON_FLOOR)):
        result = run_zarm("sensor", "calibrate", "eye", "--write", str(file), ZARM_CONNECT=endpoint)
    assert result.returncode == 0, result.stderr
    assert "view 15 of 15" in result.stdout
    (found,) = robot.perception.cameras()
    assert_found(found, IN_HAND)
    assert yaml.safe_load(file.read_text())["position"] == pytest.approx(found.position)
    assert robot.joint_state().position == pytest.approx(ABOVE, abs=1e-3)


def test_hand_eye_calibration_finds_a_fixed_camera(robot: Robot) -> None:
    flange = MODEL.fk_tip(np.array(ABOVE))
    x, y, z = flange[:3, 3].tolist()
    looking = zarm.Camera("eye", position=(1.2, -0.3, 0.6), look_at=(x, y, z), **PIXELS)
    beside = matrix(looking.position, looking.orientation)
    on_flange = np.linalg.inv(flange) @ beside @ matrix((-0.14, -0.1, 0.8))
    robot.perception.add(off(beside))
    outward = np.linalg.inv(beside)
    with painted(robot, "eye", lambda q: image_of(BOARD, SIZE, outward @ MODEL.fk_tip(q) @ on_flange)):
        found = calibrate(robot, "eye", BOARD, board_link="tool0")
    assert_found(found.camera, beside)
    assert found.reprojection_error < 0.5
    assert robot.perception.cameras() == (found.camera,)


def test_a_board_of_another_size_changes_nothing(robot: Robot) -> None:
    declared = off(IN_HAND).model_copy(update={"link": "tool0"})
    robot.perception.add(declared)
    larger = Board(square=0.044, marker=0.033)
    refused = pytest.raises(
        zarm.InvalidRequest, match=r"the reprojection error is .* pixels, so eye stays where it was"
    )
    below = painted(robot, "eye", lambda q: image_of(BOARD, SIZE, np.linalg.inv(MODEL.fk_tip(q) @ IN_HAND) @ ON_FLOOR))
    with below, refused:
        calibrate(robot, "eye", larger, views=6)
    assert robot.perception.cameras() == (declared,)


@pytest.mark.skipif(
    not (find_library("EGL") or find_library("OSMesa") or "MUJOCO_GL" in os.environ), reason="nothing renders here"
)
@pytest.mark.timeout(400)
def test_cameras_of_a_robot_with_mass_are_found_where_they_are(tmp_path: Path) -> None:
    with cell_of(tmp_path, world="board") as cell:
        robot = cell.robot
        in_hand = Camera(name="eye", link="tool0", position=(0.05, 0.0, 0.03), rate=3.0, **PIXELS)
        robot.perception.add(in_hand)
        robot.execute(robot.plan(zarm.Pose((0.45, 0.0, 0.5), (1.0, 0.0, 0.0, 0.0))))
        found = calibrate(robot, "eye").camera
        assert_found(found, matrix(in_hand.position, in_hand.orientation))
        assert robot.perception.color("eye").shape == (480, 640, 3)

        robot.perception.remove("eye")
        eventually(lambda: not robot.perception.state().stale, "no camera is missed")
        robot.execute(robot.plan(zarm.Pose((0.35, 0.1, 0.5), (0.0, math.sqrt(0.5), 0.0, math.sqrt(0.5)))))
        carry_board(cell)
        beside = zarm.Camera("side", position=(1.15, -0.1, 0.55), look_at=(0.35, 0.1, 0.5), rate=3.0, **PIXELS)
        robot.perception.add(beside)
        found = calibrate(robot, "side", board_link="tool0").camera
        assert_found(found, matrix(beside.position, beside.orientation))


def carry_board(cell: Cell) -> None:
    """A board on the flange, in the scene and in truth."""
    tip = cell.robot.tip()
    place = pose_of(matrix(tip.position, tip.orientation) @ matrix((0.0, 0.0, 0.02)))
    board = Cuboid(
        kind="cuboid", name="held", position=place.position, orientation=place.orientation, size=(0.28, 0.2, 0.01)
    )
    cell.robot.scene.add(board)
    cell.robot.scene.attach("held")
    picture = Texture(name="held", image=base64.b64encode(BOARD.picture()).decode())
    light = DynamicObject(name="held", mass=0.3)
    cell.bus.call(
        cell.keys.physics_world, LoadWorld(objects=(board,), dynamic=(light,), textures=(picture,)), timeout=20.0
    )


def test_a_camera_that_cannot_be_calibrated_is_refused_by_field(robot: Robot) -> None:
    robot.perception.add(off(IN_HAND))
    for name, link, words in (
        ("other", None, "there is no camera other; there are eye"),
        ("eye", None, "eye is not on the arm; name the link that carries the board"),
    ):
        with pytest.raises(zarm.InvalidRequest, match=words):
            calibrate(robot, name, board_link=link)
    robot.perception.add(off(IN_HAND).model_copy(update={"link": "tool0"}))
    with pytest.raises(zarm.InvalidRequest, match="eye is on the arm, so the board stands still; leave this out"):
        calibrate(robot, "eye", board_link="tool0")
    with pytest.raises(zarm.InvalidRequest, match=r"markers of 0.05 m do not fit into squares of 0.04 m"):
        Board(marker=0.05)
    with pytest.raises(zarm.InvalidRequest, match="4 views do not determine the pose; use 5 or more"):
        calibrate(robot, "eye", views=4)
    blank = np.full((480, 640), 200, np.uint8)
    seen = pytest.raises(zarm.Unavailable, match="the camera eye sees no board; move the arm until it sees all of it")
    with painted(robot, "eye", lambda _: blank), seen:
        calibrate(robot, "eye")
    assert robot.joint_state().position == pytest.approx(ABOVE, abs=1e-3)
