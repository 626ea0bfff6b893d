"""Objects are picked up and placed step by step; a step that fails says which, and nothing has moved for it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest

import zarm
from support.example_programs import run_example
from support.gripper_arm import m1013_with_gripper
from support.harness import ServiceProcess, router
from zarm_contract.keys import Keys
from zarm_runtime.bus import Bus

DOWN = (1.0, 0.0, 0.0, 0.0)
TABLE = zarm.Cuboid("table", size=(0.6, 1.3, 0.1), position=(0.5, 0.0, -0.055))
BOX = zarm.Cuboid("box", size=(0.04, 0.04, 0.05), position=(0.5, -0.2, 0.0195))
"""It stands 0.5 mm in the table, as a camera may see it."""
GRASP, THERE = zarm.Pose((0.5, -0.2, 0.03), DOWN), zarm.Pose((0.45, 0.15, 0.032), DOWN)
LONGEST = 400.0


class Cell:
    """An M1013 with a gripper, its planner and executor, and a client."""

    def __init__(self, stack: ExitStack, folder: Path) -> None:
        self.endpoint = stack.enter_context(router())
        bus = stack.enter_context(Bus(self.endpoint))
        robot = str(m1013_with_gripper(folder))
        for service in ("planner", "executor"):
            process = ServiceProcess(service, self.endpoint, folder, robot)
            stack.enter_context(process).wait_ready(bus, Keys("doosan_m1013"))
        self.robot = stack.enter_context(zarm.connect(self.endpoint))


@pytest.fixture(scope="module")
def cell(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cell]:
    with ExitStack() as stack:
        yield Cell(stack, tmp_path_factory.mktemp("cell"))


@pytest.fixture
def robot(cell: Cell) -> zarm.Robot:
    """The robot in front of a box on a table, with an open gripper."""
    for name in cell.robot.scene.attached():
        cell.robot.scene.detach(name)
    cell.robot.scene.clear()
    cell.robot.gripper.open()
    cell.robot.execute(cell.robot.plan((0.0, 0.0, 1.5708, 0.0, 1.5708, 0.0)))
    cell.robot.scene.add(TABLE, BOX)
    return cell.robot


def test_a_box_is_carried_upright_to_another_place(robot: zarm.Robot) -> None:
    held = robot.pick("box", zarm.PoseGoal(GRASP, free=["theta_z"]), width=0.04)
    assert held.width == pytest.approx(0.04, abs=1e-3)
    assert robot.tip().position[2] == pytest.approx(GRASP.position[2] + 0.1, abs=1e-3)
    assert set(robot.scene.attached()["box"].touch_links) == {"left_finger", "right_finger", "hand"}
    state = robot.place(THERE, upright=True)
    assert state.width == pytest.approx(0.08, abs=1e-3)
    assert robot.scene.objects()["box"].position == pytest.approx((0.45, 0.15, 0.0215), abs=1e-3)
    assert robot.tip().position[2] == pytest.approx(THERE.position[2] + 0.1, abs=1e-3)


def test_of_several_grasps_a_free_one_is_chosen(robot: zarm.Robot) -> None:
    robot.scene.add(zarm.Cuboid("wall", size=(0.04, 0.02, 0.1), position=(0.5, -0.15, 0.05)))
    across = zarm.Pose(GRASP.position, (0.7071068, 0.7071068, 0.0, 0.0))
    held = robot.pick("box", zarm.AnyOf(GRASP, across), width=0.04)
    assert held.status == "reached"


def test_what_the_fingers_touch_is_attached(robot: zarm.Robot) -> None:
    robot.scene.add(zarm.Cuboid("cup", size=(0.04, 0.04, 0.05), position=(0.5, 0.2, 0.025)))
    robot.pick(None, GRASP, width=0.04, touch=("cup", "box"))
    assert list(robot.scene.attached()) == ["box"]


def test_fingers_that_touch_nothing_known_attach_nothing(robot: zarm.Robot) -> None:
    robot.scene.add(zarm.Cuboid("cup", size=(0.04, 0.04, 0.05), position=(0.5, 0.2, 0.025)))
    robot.scene.remove("box")
    with pytest.raises(zarm.ExecutionFailed, match="attach what is there: the fingers touch none of cup"):
        robot.pick(None, GRASP, width=0.04, touch=("cup",))
    assert robot.scene.attached() == {}


def test_fingers_that_close_on_nothing_end_the_pick_at_close(robot: zarm.Robot) -> None:
    with pytest.raises(zarm.ExecutionFailed, match="close box: the fingers have closed on nothing"):
        robot.pick("box", GRASP)
    assert robot.scene.attached() == {}


def test_a_grasp_that_cannot_be_reached_opens_nothing(robot: zarm.Robot) -> None:
    robot.gripper.close()
    with pytest.raises(zarm.PlanningFailed, match="reach box: "):
        robot.pick("box", zarm.Pose((3.0, 0.0, 0.03), DOWN))
    assert robot.gripper.state().width == pytest.approx(0.0, abs=1e-3)


def test_fingers_stand_while_an_unguarded_robot_follows_a_plan(robot: zarm.Robot) -> None:
    goal = robot.start(robot.plan((1.0, 0.0, 1.5708, 0.0, 1.5708, 0.0), velocity_scale=0.2))
    with pytest.raises(zarm.Busy, match=f"the robot follows {goal}, which was checked with the fingers where they are"):
        robot.gripper.close()
    assert robot.gripper.state().width == pytest.approx(0.08, abs=1e-3)
    robot.cancel(goal)
    robot.follow(goal)
    assert robot.gripper.close().status == "reached"


def test_fingers_do_not_open_into_what_stands_beside(robot: zarm.Robot) -> None:
    robot.pick("box", GRASP, width=0.04)
    robot.scene.add(zarm.Cuboid("neighbour", size=(0.04, 0.04, 0.05), position=(0.45, 0.215, 0.025)))
    with pytest.raises(zarm.PlanningFailed, match=r"open box: .*neighbour"):
        robot.place(THERE)
    assert robot.gripper.state().width == pytest.approx(0.04, abs=1e-3)
    assert "box" in robot.scene.attached()


@pytest.mark.parametrize(
    ("act", "message"),
    [
        (lambda robot: robot.pick("cup", GRASP), "there is no object cup in the scene, which holds table, box"),
        (lambda robot: robot.pick(None, GRASP), "name the object, or in `touch` those that may be there"),
        (lambda robot: robot.pick("box", (0.0,) * 6), "give a zarm.Pose"),
        (lambda robot: robot.place(THERE), "the robot carries nothing"),
        (lambda robot: robot.place(THERE, item="box"), "does not carry box"),
    ],
)
def test_what_makes_no_sense_is_refused(robot: zarm.Robot, act: object, message: str) -> None:
    with pytest.raises(zarm.InvalidRequest, match=message):
        act(robot)  # type: ignore[operator]


@pytest.mark.slow
@pytest.mark.timeout(LONGEST + 20.0)
def test_the_example_moves_ten_boxes_into_a_tray(cell: Cell, robot: zarm.Robot) -> None:
    said = run_example("14_pick_and_place", cell.endpoint, LONGEST)
    assert said.count("stands at") == 10
