"""The page in a real browser: planner, servo, executor and viewer in their own processes, and Chromium."""

from __future__ import annotations

import io
import os
import re
import signal
from base64 import b64encode
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from playwright.sync_api import Browser, Page, expect

import zarm
from support.command_line import Command
from support.harness import PATIENCE, eventually
from support.trajectories import HOME, KEYS, ROBOT, moved
from support.viewer import (
    COARSE,
    SIZE,
    Cell,
    cell_of,
    drawn_ghost,
    drawn_link,
    drawn_tip,
    drawn_width,
    free_port,
    opened,
)
from zarm_contract.image import encode_image
from zarm_contract.messages import AgentAnswer, AgentQuestion, Cameras, ImageHeader, Plan, Planners, VoxelBlock
from zarm_contract.robot import load_robot
from zarm_trajectory.trajectory import TimedTrajectory
from zarm_viewer.kinematics import Chain

pytestmark = (
    pytest.mark.timed
)  # who jogs keeps the robot as long as their page asks 7 times a second, which it draws in software
PHONE, TABLET = (390, 844), (820, 1180)


@pytest.fixture(scope="module")
def cell(chromium: Browser, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cell]:
    with cell_of(tmp_path_factory.mktemp("cell"), "planner", "executor", "servo") as started:
        yield started


@pytest.fixture(scope="module")
def address(cell: Cell) -> str:
    return cell.serve()


@pytest.fixture(scope="module")
def shared(chromium: Browser, address: str) -> Iterator[Page]:
    page = opened(chromium, address)
    yield page
    page.close()


@pytest.fixture
def page(shared: Page, cell: Cell) -> Page:
    """The page, with the robot at rest at home in an empty scene."""
    shared.mouse.up()
    cell.home()
    shared.get_by_role("tab", name="Move").click()
    return shared


@pytest.fixture(scope="module")
def second(chromium: Browser, address: str) -> Iterator[Page]:
    """Somebody else's page."""
    page = opened(chromium, address)
    yield page
    page.close()


def looks(page: Page, at: tuple[float, float], half: int = 12) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    """The pixels around a place on the page."""
    box = (int(at[0]) - half, int(at[1]) - half, int(at[0]) + half, int(at[1]) + half)
    picture = Image.open(io.BytesIO(page.screenshot(scale="css", timeout=PATIENCE * 1e3))).convert("RGB").crop(box)
    return np.asarray(picture, dtype=np.float64)


def drawn_where_measured(page: Page, cell: Cell) -> bool:
    """Whether the scene graph of the page has the tip where the bus says that it is."""
    tip = drawn_tip(page)
    return tip is not None and bool(np.allclose(tip, cell.robot.tip().position, atol=1e-3))


def drawn(page: Page, node: str) -> bool:
    """Whether the scene graph of the page has this node of the robot."""
    return bool(page.evaluate("name => !!window.__viserMutable.nodeRefFromName[name]?.parent", f"/{KEYS.robot}/{node}"))


def drag(page: Page, at: tuple[float, float], down: int) -> None:
    """Drag a handle by its arrow down the page."""
    page.mouse.move(*at)
    page.mouse.down()
    for step in range(1, 11):
        page.mouse.move(at[0], at[1] + down * step / 10)
    page.mouse.up()


def choose(page: Page, label: str, option: str) -> None:
    """Choose from a list."""
    page.get_by_role("combobox", name=label).click()
    page.get_by_role("option", name=option, exact=True).click()


def aim_home(page: Page) -> None:
    """Aim at home, among the poses, which are unfolded if they are not."""
    home = page.get_by_role("button", name="Home")
    if not home.is_visible():
        page.get_by_text("Poses").click()
    home.click()


def hold(page: Page, label: str) -> None:
    """Press a button of the page and keep it pressed."""
    button = page.get_by_role("button", name=label)
    button.scroll_into_view_if_needed()
    box = button.bounding_box()
    assert box is not None
    page.mouse.up()
    page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    page.mouse.down()


def test_the_robot_is_drawn_where_the_bus_says_that_it_is(page: Page, cell: Cell) -> None:
    for joints in (HOME, moved(0.6)):
        cell.robot.execute(cell.robot.plan(joints))
        eventually(lambda: drawn_where_measured(page, cell), "the scene graph has the tip where it is")
        eventually(lambda: looks(page, cell.tip_pixel()).std() > 20, "the pixels show the tip there")
    expect(page.get_by_text("idle").first).to_be_visible()


def test_dragging_the_handle_previews_and_executes(page: Page, cell: Cell) -> None:
    tip = cell.robot.tip().position
    drag(page, cell.pixel((tip[0], tip[1], tip[2] - 0.12)), 32)  # by the arrow of the tip's z, which looks down
    expect(page.get_by_text("reachable, free")).to_be_visible()
    page.get_by_role("button", name="Plan and execute").click()
    eventually(lambda: cell.robot.tip().position[2] < tip[2] - 0.03, "the robot has gone down")
    eventually(cell.rests, "it rests")


@pytest.mark.slow  # as the drawing is
def test_the_numbers_are_those_of_the_robot_until_somebody_aims(page: Page, cell: Cell) -> None:
    page.get_by_text("Joints (deg)").click()
    cell.robot.execute(cell.robot.plan((*HOME[:5], 0.5)))  # the tip turns, and stays where it is
    expect(page.locator("input[value='28.6']:not([type='hidden'])").first).to_be_visible()
    page.get_by_text("Joints (deg)").click()


@pytest.mark.slow  # the planner refuses it on the bus, in process/planner
def test_a_goal_in_collision_is_shown_and_not_executed(page: Page, cell: Cell) -> None:
    cell.robot.execute(cell.robot.plan(moved(1.0)))
    x, y, z = Chain(ROBOT).tip(np.array(HOME)).translation()
    cell.robot.scene.add(zarm.Cuboid("in_the_way", size=(0.1, 0.1, 0.1), position=(x, y, z)))
    aim_home(page)
    expect(page.get_by_text("collision", exact=True)).to_be_visible()
    reported = page.get_by_role("alert")
    assert drawn(page, "path")
    page.get_by_role("button", name="Plan", exact=True).click()
    expect(reported.filter(has_text="Plan:").first).to_be_visible()
    eventually(lambda: not drawn(page, "path"), "the path of the plan before is gone")
    page.get_by_role("button", name="Execute", exact=True).click()
    expect(reported.filter(has_text="there is no plan").first).to_be_visible()
    expect(page.get_by_text("clearance")).to_be_hidden()
    assert cell.rests()
    page.get_by_role("button", name="Back to the robot").click()
    page.get_by_text("Poses").click()


def test_the_page_offers_the_planners_that_the_planner_has(page: Page, cell: Cell) -> None:
    page.get_by_text("Options", exact=True).click()
    planner = page.get_by_role("combobox", name="planner")

    def offers(*names: str) -> None:
        planner.click()
        for name in names:
            expect(page.get_by_role("option", name=name, exact=True)).to_be_visible()
        planner.press("Escape")

    known = cell.bus.read(KEYS.planners, timeout=PATIENCE)
    offers(*known.names)
    assert "joint_space" in known.names
    restarted = cell.bus.publisher(KEYS.planners)
    restarted.put(Planners(names=(*known.names, "straight_line")))
    offers("auto", "straight_line")
    restarted.put(known)
    page.get_by_text("Options", exact=True).click()


def test_plots_show_the_plan_and_what_the_robot_does_now(page: Page, cell: Cell) -> None:
    page.get_by_role("tab", name="Plots").click()
    of_plan, of_now = page.locator(".uplot").nth(0), page.locator(".uplot").nth(1)
    cell.robot.execute(cell.robot.plan(moved(0.4)))
    seen: list[bytes] = []
    for quantity in ("position", "velocity", "acceleration", "jerk"):
        choose(page, "of the plan", quantity)
        eventually(lambda: of_plan.screenshot(timeout=PATIENCE * 1e3) not in seen, f"a plot of the {quantity}")
        seen.append(of_plan.screenshot(timeout=PATIENCE * 1e3))
    for quantity in ("velocity", "tracking error (mrad)", "tick lateness (ms)"):
        choose(page, "live", quantity)
        shown = page.get_by_text(quantity, exact=True) if quantity.startswith("tick") else of_now
        expect(shown.first).to_be_visible()
    choose(page, "live", "off")


def test_a_plan_passes_through_a_waypoint_where_it_was_dragged(page: Page, cell: Cell) -> None:
    page.get_by_text("Waypoints").click()
    cell.robot.execute(cell.robot.plan(moved(-0.8)))
    eventually(lambda: drawn_where_measured(page, cell), "the page shows the robot there")
    page.get_by_role("button", name="Add one here").click()
    page.wait_for_function("() => '/doosan_m1013/waypoint_1' in window.__viserMutable.nodeRefFromName")
    waypoint = cell.robot.tip().position
    cell.robot.execute(cell.robot.plan(HOME))
    eventually(lambda: drawn_where_measured(page, cell), "the robot is away from the waypoint")
    drag(page, cell.pixel((waypoint[0], waypoint[1], waypoint[2] - 0.09)), 30)
    aim_home(page)
    expect(page.get_by_text("reachable, free")).to_be_visible()
    page.get_by_role("button", name="Plan", exact=True).click()

    def through() -> Plan | None:
        made = cell.bus.read(KEYS.plans, timeout=5)
        return made if made.waypoint_times else None

    plan = eventually(through, "a plan with waypoints is made")
    at = TimedTrajectory.of(plan.trajectory, ROBOT.descriptor.joints).at(plan.waypoint_times[0])[0]
    passed = Chain(ROBOT).tip(at).translation()
    assert np.allclose(passed[:2], waypoint[:2], atol=0.02)
    assert 0.03 < waypoint[2] - passed[2] < 0.3
    for label in ("Forget them", "Back to the robot"):
        page.get_by_role("button", name=label).click()
    for folder in ("Waypoints", "Poses"):
        page.get_by_text(folder).click()


def test_the_goal_is_checked_again_when_the_scene_changes(page: Page, cell: Cell) -> None:
    aim_home(page)
    expect(page.get_by_text("reachable, free")).to_be_visible()
    x, y, z = Chain(ROBOT).tip(np.array(HOME)).translation()
    cell.robot.scene.add(zarm.Cuboid("put_there_later", size=(0.1, 0.1, 0.1), position=(x, y, z)))
    expect(page.get_by_text("put_there_later").first).to_be_visible()
    cell.robot.scene.clear()
    expect(page.get_by_text("reachable, free")).to_be_visible()
    page.get_by_role("button", name="Back to the robot").click()
    page.get_by_text("Poses").click()


def test_the_handle_is_dragged_out_of_an_object(page: Page, cell: Cell) -> None:
    tip = cell.robot.tip().position
    cell.robot.scene.add(zarm.Cuboid("around_it", size=(0.5, 0.5, 0.5), position=tip))
    page.wait_for_function("() => '/doosan_m1013/scene/around_it' in window.__viserMutable.nodeRefFromName")
    drag(page, cell.pixel((tip[0], tip[1], tip[2] - 0.12)), 32)
    expect(page.get_by_text("around_it").first).to_be_visible()  # a goal was set, and collides
    page.get_by_role("button", name="Plan", exact=True).click()
    expect(page.get_by_role("alert").filter(has_text="Plan:").first).to_be_visible()
    aim_home(page)
    page.get_by_role("button", name="Back to the robot").click()
    page.get_by_text("Poses").click()


def test_jog_buttons_stay_where_they_are_while_the_robot_jogs(page: Page, cell: Cell) -> None:
    page.get_by_role("tab", name="Jog").click()
    button = page.get_by_role("button", name="+ x")

    def top() -> float:
        box = button.bounding_box()
        assert box is not None
        return box["y"]

    button.scroll_into_view_if_needed()
    before = top()
    hold(page, "+ x")
    expect(page.get_by_text("jog:").first).to_be_visible()
    assert abs(top() - before) < 5  # px: a line of the status is 20, a pressed button goes down by 1
    page.mouse.up()
    eventually(cell.rests, "it rests")
    assert abs(top() - before) < 5


@pytest.mark.slow  # as with buttons, in the tests around it
@pytest.mark.parametrize(
    ("key", "axis", "sign"), [("I", 0, 1), ("K", 0, -1), ("J", 1, 1), ("L", 1, -1), ("U", 2, 1), ("O", 2, -1)]
)
def test_a_key_with_shift_jogs_along_its_axis_until_it_is_let_go(
    page: Page, cell: Cell, key: str, axis: int, sign: int
) -> None:
    start = np.array(cell.robot.tip().position)
    page.keyboard.down("Shift")

    def moved_along() -> bool:
        page.keyboard.down(key)  # again and again, as while it is held
        way = np.array(cell.robot.tip().position) - start
        return bool(sign * way[axis] > 0.005 and np.abs(np.delete(way, axis)).max() < 0.002)

    eventually(moved_along, "the tip moves along the axis of the key")
    page.keyboard.up(key)
    page.keyboard.up("Shift")
    eventually(cell.rests, "it rests")


def test_keys_jog_the_chosen_robot_and_no_other(page: Page, cell: Cell, chromium: Browser) -> None:
    cell.begin("executor", "ur5e", "beside_it")  # without a servo, so a jog of it is refused
    both = opened(chromium, cell.serve("--robot", "beside_it=ur5e"))
    choose(both, "robot", "beside_it")
    both.mouse.click(100, 400)  # in the view: in an input, keys are letters
    before = cell.robot.joint_state().position
    reported = both.get_by_role("alert").filter(has_text="jog: unavailable")

    def refused() -> bool:
        both.keyboard.down("I")
        return reported.count() > 0

    both.keyboard.down("Shift")
    eventually(refused, "the chosen robot is asked to jog")
    assert cell.robot.joint_state().position == before
    both.close()


def test_save_and_download_save_at_once(page: Page, cell: Cell) -> None:
    records = cell.folder / KEYS.robot / "records"
    records.mkdir(parents=True, exist_ok=True)
    (records / "fault.mcap").write_bytes(b"a record")
    cell.robot.scene.add(zarm.Cuboid("to_be_saved", size=(0.1, 0.1, 0.1), position=(0.5, 0.4, 0.2)))
    page.get_by_role("tab", name="Scene").click()
    page.get_by_text("File", exact=True).click()
    with page.expect_download() as scene:
        page.get_by_role("button", name="Save").click()
    assert "to_be_saved" in scene.value.path().read_text()
    page.get_by_text("File", exact=True).click()
    page.get_by_role("tab", name="Log").click()
    with page.expect_download() as record:
        page.get_by_role("button", name="Download").click()
    assert record.value.suggested_filename == "fault.mcap"
    assert record.value.path().read_bytes() == b"a record"


def test_on_a_tablet_the_view_leaves_room_for_the_robot(page: Page, chromium: Browser, address: str) -> None:
    tablet = opened(chromium, address, TABLET)
    eventually(lambda: 0.0 < drawn_width(tablet) < 0.7, "the robot is in view, and does not fill it")
    tablet.close()


@pytest.mark.slow  # the ghost is seen where the handle is dragged
def test_a_plan_is_looked_through_before_anything_moves(page: Page, cell: Cell) -> None:
    aim_home(page)
    cell.robot.execute(cell.robot.plan(moved(0.6)))
    before = cell.robot.joint_state().position
    page.get_by_role("button", name="Plan", exact=True).click()
    slider = page.get_by_role("slider").first
    expect(slider).to_be_enabled()
    for key, joints in (("ArrowRight", moved(0.6)), ("End", HOME)):
        slider.press(key)
        end = Chain(ROBOT).tip(np.array(joints)).translation()
        eventually(lambda end=end: np.allclose(drawn_ghost(page) or 0.0, end, atol=2e-3), "the ghost is on the path")
    assert cell.robot.joint_state().position == before
    page.get_by_role("button", name="Back to the robot").click()
    page.get_by_text("Poses").click()


@pytest.mark.slow  # the stop by itself is the next test
def test_stop_works_while_planner_and_servo_hang(page: Page, cell: Cell) -> None:
    goal = cell.robot.start(cell.robot.plan(moved(1.5), velocity_scale=0.01))
    eventually(lambda: cell.robot.state().mode == "running", "it moves")
    aim_home(page)
    standing = [cell.services[name].process.pid for name in ("planner", "servo")]
    try:
        for pid in standing:
            os.kill(pid, signal.SIGSTOP)
        for _ in range(3):
            page.get_by_role("button", name="Plan", exact=True).click()
        page.get_by_role("button", name="STOP").first.click()
        assert cell.robot.follow(goal, timeout=PATIENCE).status == "cancelled"
        eventually(cell.rests, "it rests")
    finally:
        for pid in standing:
            os.kill(pid, signal.SIGCONT)
    page.get_by_role("button", name="Back to the robot").click()
    page.get_by_text("Poses").click()


def test_stop_brings_the_robot_to_rest_before_its_goal(page: Page, cell: Cell) -> None:
    goal = cell.robot.start(cell.robot.plan(moved(1.5), velocity_scale=0.1))
    eventually(lambda: cell.robot.state().mode == "running", "it moves")
    page.get_by_role("button", name="STOP").first.click()
    assert cell.robot.follow(goal, timeout=PATIENCE).status == "cancelled"
    eventually(cell.rests, "it rests")


def test_an_object_added_on_one_page_appears_on_the_other(page: Page, cell: Cell, second: Page) -> None:
    for each in (page, second):
        each.get_by_role("tab", name="Scene").click()
    page.get_by_role("button", name="Add", exact=True).click()
    eventually(lambda: "box" in cell.robot.scene.objects(), "the box is in the scene")
    expect(second.locator("input[value='box']").first).to_be_visible()
    page.get_by_role("button", name="Remove").click()
    eventually(lambda: not cell.robot.scene.objects(), "it is gone")


def test_what_cameras_see_is_drawn_and_goes_with_it(page: Page, cell: Cell) -> None:
    blocks, key = cell.bus.latched(KEYS.voxels("*")), KEYS.voxels("3.2.1")
    corner = VoxelBlock(position=(-0.6, 0.7, 0.2), resolution=0.02, cells=b64encode(bytes(511) + b"\xff").decode())
    blocks.set(corner, key=key)
    eventually(lambda: drawn(page, "map/map.3.2.1"), "the block is drawn")
    blocks.set(corner.model_copy(update={"cells": ""}), key=key)
    eventually(lambda: not drawn(page, "map/map.3.2.1"), "the block has gone")


def test_a_camera_is_drawn_where_it_is_with_its_newest_image(page: Page, cell: Cell) -> None:
    sizes = {"width": 64, "height": 48, "fx": 60.0, "fy": 60.0, "cx": 31.5, "cy": 23.5}
    camera = zarm.Camera("front", position=(1.0, 0.5, 0.8), look_at=(0.3, 0.0, 0.2), **sizes)
    cameras, images = cell.bus.publisher(KEYS.cameras), cell.bus.publisher(KEYS.depth("front"))
    header = ImageHeader(stamp=0.0, width=64, height=48, encoding="16UC1")

    def shown() -> bool:
        images.put_encoded(encode_image(header, np.full((48, 64), 900, "<u2").tobytes()))
        return bool(drawn(page, "robot/camera_front"))

    cameras.put(Cameras(cameras=(camera,)))
    eventually(shown, "the camera is drawn")
    cameras.put(Cameras())
    eventually(lambda: not drawn(page, "robot/camera_front"), "the camera has gone")


def test_on_a_phone_stop_is_always_in_reach(page: Page, second: Page) -> None:
    second.set_viewport_size({"width": PHONE[0], "height": PHONE[1]})
    stop = second.get_by_role("button", name="STOP").first
    second.mouse.move(PHONE[0] / 2, 0.8 * PHONE[1])
    for screens in (0.0, 0.1, 0.2, 10.0, -20.0):
        second.mouse.wheel(0, screens * PHONE[1])
        expect(stop).to_be_in_viewport(ratio=1.0)
    second.set_viewport_size({"width": SIZE[0], "height": SIZE[1]})


def test_jogging_is_exclusive_and_ends_with_its_page(
    page: Page, cell: Cell, chromium: Browser, address: str, second: Page
) -> None:
    for each in (page, second):
        each.get_by_role("tab", name="Jog").click()
    start = cell.robot.tip().position
    hold(second, "+ x")
    eventually(lambda: abs(cell.robot.tip().position[0] - start[0]) > 0.01, "it moves as long as the button is held")
    reported = [each.get_by_text("Somebody else jogs").first for each in (page, second)]

    def one_is_told() -> bool:
        if cell.rests():  # a page that was held up has let go
            hold(second, "+ x")
        hold(page, "− x")
        return any(each.is_visible() for each in reported)

    eventually(one_is_told, "who does not have the robot is told")
    page.mouse.up()
    second.goto("about:blank")
    eventually(cell.rests, "the robot rests")


@pytest.mark.slow  # as when the page is lost
def test_frozen_tabs_end_jogging_and_not_goals(page: Page, cell: Cell, chromium: Browser, address: str) -> None:
    jogging = opened(chromium, address)
    jogging.get_by_role("tab", name="Jog").click()
    start = cell.robot.tip().position
    hold(jogging, "+ x")
    eventually(lambda: abs(cell.robot.tip().position[0] - start[0]) > 0.01, "it moves as long as the button is held")
    processes = chromium.new_browser_cdp_session().send("SystemInfo.getProcessInfo")["processInfo"]
    tabs = [process["id"] for process in processes if process["type"] == "renderer"]
    for tab in tabs:
        os.kill(tab, signal.SIGSTOP)
    try:
        eventually(cell.rests, "the robot rests")
        cell.robot.execute(cell.robot.plan(moved(0.5)))
    finally:
        for tab in tabs:
            os.kill(tab, signal.SIGCONT)
    jogging.mouse.up()
    eventually(cell.rests, "nobody holds the button any more")
    for each in (page, jogging):
        eventually(lambda shown=each: drawn_where_measured(shown, cell), "the page shows the robot where it is now")
    jogging.close()


@pytest.mark.slow  # as when the page is lost
def test_a_hanging_viewer_ends_jogging_and_not_goals(page: Page, cell: Cell, chromium: Browser) -> None:
    address, viewer = cell.serve(), cell.viewer
    jogging = opened(chromium, address)
    jogging.get_by_role("tab", name="Jog").click()
    start = cell.robot.tip().position
    hold(jogging, "+ x")
    eventually(lambda: abs(cell.robot.tip().position[0] - start[0]) > 0.01, "it moves as long as the button is held")
    os.kill(viewer.process.pid, signal.SIGSTOP)
    eventually(cell.rests, "the robot rests")
    goal = cell.robot.start(cell.robot.plan(HOME, velocity_scale=0.1))
    eventually(lambda: cell.robot.state().mode == "running", "a goal moves it")
    viewer.kill()
    assert cell.robot.follow(goal, timeout=PATIENCE).status == "succeeded"
    jogging.close()


def test_a_viewer_sees_two_robots_and_can_only_stop(page: Page, cell: Cell, chromium: Browser) -> None:
    other = load_robot("ur5e")
    cell.begin("executor", "ur5e", "other")
    watching = opened(chromium, cell.serve("--role", "viewer", "--robot", "other=ur5e"))
    expect(watching.get_by_text("idle").first).to_be_visible()
    eventually(lambda: drawn_where_measured(watching, cell), "the one is where the bus says that it is")
    home = Chain(other).tip(np.array(other.descriptor.home)).translation()
    eventually(lambda: np.allclose(drawn_tip(watching, "other") or (), home, atol=1e-3), "and so is the other")
    assert set(watching.get_by_role("tab").all_inner_texts()) == {"Look", "Plots", "Log", "Stop"}
    assert {button for button in watching.get_by_role("button").all_inner_texts() if button} == {"STOP"}
    watching.get_by_role("tab", name="Look").click()
    for box in ("collision spheres", "clearance"):
        watching.get_by_role("checkbox", name=box).click()
    nearest = watching.get_by_text(re.compile(r"clearance \d+ mm:"))  # and the two links
    expect(nearest).to_be_visible()
    robot = watching.get_by_role("combobox", name="robot")
    robot.click()
    watching.get_by_role("option", name="other").click()
    expect(robot).to_have_value("other")
    expect(nearest).to_be_hidden()
    watching.close()


def test_the_gripper_tab_closes_the_fingers_that_are_drawn(cell: Cell, chromium: Browser) -> None:
    cell.begin("executor", "panda", "panda")
    page = opened(chromium, cell.serve("--robot", "panda=panda"))
    robot = page.get_by_role("combobox", name="robot")
    robot.click()
    page.get_by_role("option", name="panda").click()
    page.get_by_role("tab", name="Gripper").click()
    fingers = ("panda_leftfinger", "panda_rightfinger")

    def apart() -> float | None:
        drawn = [drawn_link(page, "panda", finger) for finger in fingers]
        return None if None in drawn else float(np.linalg.norm(np.subtract(*drawn)))

    eventually(lambda: (width := apart()) is not None and abs(width - 0.08) < 2e-3, "the gripper is drawn open")
    page.get_by_role("button", name="Close hand").click()
    eventually(lambda: (width := apart()) is not None and width < 2e-3, "the fingers are drawn closed")
    expect(page.get_by_text("reached").first).to_be_visible()
    with zarm.connect(cell.endpoint, "panda") as panda:
        assert panda.gripper.state().width == pytest.approx(0.0, abs=1e-3)
    page.close()


def test_a_record_plays_on_a_page_to_its_end(cell: Cell, chromium: Browser, tmp_path: Path) -> None:
    cell.home()
    file = str(tmp_path / "one.mcap")
    with Command("record", file, "--name", KEYS.robot, folder=tmp_path, ZARM_CONNECT=cell.endpoint) as recording:
        eventually(lambda: "Ctrl-C" in recording.errors(), "it records")
        cell.robot.execute(cell.robot.plan(moved(0.4)))
        recording.interrupt()
        assert recording.end() == 0
    listen = f"127.0.0.1:{free_port()}"
    with Command("replay", "--view", file, folder=tmp_path, ZARM_VIEW=listen) as replay:
        replay.wait_for("http://")
        page = chromium.new_page(viewport={"width": SIZE[0], "height": SIZE[1]}, device_scale_factor=COARSE)
        page.goto(f"http://{listen}/")
        end = Chain(ROBOT).tip(np.array(moved(0.4))).translation()
        eventually(lambda: np.allclose(drawn_tip(page) or 0.0, end, atol=2e-3), "it plays to its end")
        page.close()


def test_the_page_goes_on_when_the_executor_is_started_again(page: Page, cell: Cell) -> None:
    cell.services["executor"].kill()
    expect(page.get_by_text("no joint states")).to_be_visible()
    cell.services["executor"] = cell.begin("executor")
    cell.services["executor"].wait_ready(cell.bus, KEYS)
    expect(page.get_by_text("no joint states")).to_be_hidden()


@pytest.mark.slow  # as the bridge does, in ros/test_router_failures.py
def test_the_page_goes_on_when_the_router_is_started_again(page: Page, cell: Cell) -> None:
    cell.router.close()
    expect(page.get_by_text("no joint states")).to_be_visible()
    cell.open_router()
    expect(page.get_by_text("no joint states")).to_be_hidden()
    for process in cell.services.values():
        process.wait_ready(cell.bus, KEYS)
    aim_home(page)
    expect(page.get_by_text("reachable, free")).to_be_visible()
    cell.robot.execute(cell.robot.plan(moved(0.3)))
    eventually(lambda: drawn_where_measured(page, cell), "the page shows where it has gone")


@pytest.mark.slow  # as the drawing is
def test_a_question_of_an_agent_is_answered_on_the_page(page: Page, cell: Cell) -> None:
    answers: list[AgentAnswer] = []
    unsubscribe = cell.bus.subscribe(KEYS.agent_answer, lambda _, answer: answers.append(answer))
    questions = cell.bus.publisher(KEYS.agent_question)
    approve = page.get_by_role("button", name="Approve")
    expect(approve).to_be_hidden()

    def shown(question: str) -> bool:
        questions.put(AgentQuestion(question=question, tool="execute", text="The agent wants to execute plan-1."))
        return approve.is_visible()

    for question, button in (("one", "Approve"), ("two", "Decline")):
        eventually(lambda question=question: shown(question), "the question is shown")
        expect(page.get_by_text("The agent wants to execute plan-1.")).to_be_visible()
        page.get_by_role("button", name=button).click()
        eventually(lambda: answers and answers[-1].question == question, "it is answered")  # noqa: B023
        expect(approve).to_be_hidden()
    unsubscribe()
    assert [(answer.question, answer.approve) for answer in answers] == [("one", True), ("two", False)]
