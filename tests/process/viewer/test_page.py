"""The page in a real browser: planner, servo, executor and viewer in their own processes, and Chromium."""

from __future__ import annotations

import io
import re
import socket
import urllib.error
import urllib.request
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from playwright.sync_api import Browser, Page, expect

import zarm
from support.browser import CHROMIUM, browser, pixel
from support.harness import PATIENCE, ServiceProcess, eventually, router
from support.trajectories import HOME, KEYS
from zarm_runtime.bus import Bus

pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="no chromium here; `apt-get install chromium` brings it")

SIZE = (1280, 800)
expect.set_options(timeout=PATIENCE * 1e3)


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


class Cell:
    """One robot with its processes, and a page that shows it."""

    def __init__(self, stack: ExitStack, folder: Path) -> None:
        self.stack, self.folder = stack, folder
        self.endpoint = stack.enter_context(router())
        self.bus = stack.enter_context(Bus(self.endpoint))
        self.services = {
            service: stack.enter_context(ServiceProcess(service, self.endpoint, folder))
            for service in ("planner", "executor", "servo")
        }
        for process in self.services.values():
            process.wait_ready(self.bus, KEYS)
        self.robot = stack.enter_context(zarm.connect(self.endpoint))
        self.address = self.serve()

    def serve(self, *arguments: str) -> str:
        """The address of a viewer that is started with these arguments."""
        address = f"127.0.0.1:{free_port()}"
        viewer = ServiceProcess("viewer", self.endpoint, self.folder, arguments=("--listen", address, *arguments))
        self.stack.enter_context(viewer)

        def answers() -> bool:
            assert viewer.process.poll() is None, viewer.output()
            try:
                with urllib.request.urlopen(f"http://{address}/", timeout=5):
                    return True
            except urllib.error.URLError:
                return False

        eventually(answers, "the page is served")
        return f"http://{address}/"

    def rests(self) -> bool:
        return self.robot.state().mode == "idle" and max(map(abs, self.robot.joint_state().velocity)) < 1e-4


@pytest.fixture(scope="module")
def cell(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cell]:
    with ExitStack() as stack:
        yield Cell(stack, tmp_path_factory.mktemp("cell"))


@pytest.fixture(scope="module")
def chromium() -> Iterator[Browser]:
    with browser() as started:
        yield started


@pytest.fixture(scope="module")
def shared(cell: Cell, chromium: Browser) -> Page:
    return opened(chromium, cell.address)


@pytest.fixture
def page(shared: Page, cell: Cell) -> Page:
    """The page, with the robot at rest at home in an empty scene."""
    cell.robot.stop()
    eventually(cell.rests, "the robot rests")
    cell.robot.scene.clear()
    if not np.allclose(cell.robot.joint_state().position, HOME, atol=1e-3):
        cell.robot.execute(cell.robot.plan(HOME))
    shared.get_by_role("tab", name="Move").click()
    return shared


def opened(chromium: Browser, address: str, size: tuple[int, int] = SIZE) -> Page:
    page = chromium.new_page(viewport={"width": size[0], "height": size[1]})
    page.goto(address)
    expect(page.get_by_text("STOP").first).to_be_visible()
    return page


def tip_pixel(cell: Cell) -> tuple[float, float]:
    return pixel(cell.robot.tip().position, *SIZE)


def looks(page: Page, at: tuple[float, float], half: int = 12) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    """The pixels around a place on the page."""
    box = (int(at[0]) - half, int(at[1]) - half, int(at[0]) + half, int(at[1]) + half)
    picture = Image.open(io.BytesIO(page.screenshot(timeout=PATIENCE * 1e3))).convert("RGB").crop(box)
    return np.asarray(picture, dtype=np.float64)


def hold(page: Page, label: str) -> None:
    """Press a button of the page and keep it pressed."""
    box = page.get_by_role("button", name=label).bounding_box()
    assert box is not None
    page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    page.mouse.down()


def test_the_robot_is_drawn_where_the_bus_says_that_it_is(page: Page, cell: Cell) -> None:
    before = tip_pixel(cell)
    eventually(lambda: looks(page, before).std() > 20, "the tip is drawn")
    cell.robot.execute(cell.robot.plan((0.6, *HOME[1:])))
    after = tip_pixel(cell)
    eventually(lambda: looks(page, after).std() > 20, "the tip is drawn where it has gone")
    eventually(lambda: page.get_by_text("idle").first.is_visible(), "the status says that it rests")


def test_dragging_the_handle_shows_a_ghost_and_the_robot_goes_there(page: Page, cell: Cell) -> None:
    tip = cell.robot.tip()
    x, y = pixel(
        (tip.position[0], tip.position[1], tip.position[2] - 0.12), *SIZE
    )  # the arrow of the tip's z, which looks down
    page.mouse.move(x, y)
    page.mouse.down()
    for step in range(1, 11):
        page.mouse.move(x, y + 4 * step)
    page.mouse.up()
    expect(page.get_by_text("reachable, free")).to_be_visible()
    page.get_by_role("button", name="Plan and execute").click()
    eventually(lambda: cell.robot.tip().position[2] < tip.position[2] - 0.03, "the robot has gone down")
    eventually(cell.rests, "it rests")


def test_stop_brings_the_robot_to_rest_before_its_goal(page: Page, cell: Cell) -> None:
    goal = cell.robot.start(cell.robot.plan((1.5, *HOME[1:]), velocity_scale=0.1))
    eventually(lambda: cell.robot.state().mode == "running", "it moves")
    page.get_by_role("button", name="STOP").first.click()
    assert cell.robot.follow(goal, timeout=PATIENCE).status == "cancelled"
    eventually(cell.rests, "it rests")


def test_an_object_added_on_one_page_is_on_the_bus_and_on_the_other_page(
    page: Page, cell: Cell, chromium: Browser
) -> None:
    other = opened(chromium, cell.address)
    for each in (page, other):
        each.get_by_role("tab", name="Scene").click()
    page.get_by_role("button", name="Add", exact=True).click()
    eventually(lambda: "box" in cell.robot.scene.objects(), "the box is in the scene")
    expect(other.locator("input[value='box']").first).to_be_visible()
    page.get_by_role("button", name="Remove").click()
    eventually(lambda: not cell.robot.scene.objects(), "it is gone")
    other.close()


def test_a_page_that_is_lost_while_jogging_lets_the_robot_rest(page: Page, cell: Cell, chromium: Browser) -> None:
    other = opened(chromium, cell.address)
    other.get_by_role("tab", name="Jog").click()
    start = cell.robot.tip().position
    hold(other, "+ hold")
    eventually(
        lambda: abs(cell.robot.tip().position[0] - start[0]) > 0.01, "the robot moves as long as the button is held"
    )
    other.close()
    eventually(cell.rests, "the robot rests")
    assert cell.robot.tip().position[0] < start[0] + 0.3


def test_a_viewer_sees_everything_and_can_only_stop(page: Page, cell: Cell, chromium: Browser) -> None:
    watching = opened(chromium, cell.serve("--role", "viewer"))
    expect(watching.get_by_text("idle").first).to_be_visible()
    assert set(watching.get_by_role("tab").all_inner_texts()) == {"Look", "Plots", "Events", "Stop"}
    assert {button for button in watching.get_by_role("button").all_inner_texts() if button} == {"STOP"}
    watching.get_by_role("tab", name="Look").click()
    for box in ("collision spheres", "clearance"):
        watching.get_by_role("checkbox", name=box).click()
    expect(watching.get_by_text(re.compile(r"clearance \d+ mm"))).to_be_visible()
    watching.close()


def test_the_page_goes_on_when_the_executor_is_started_again(page: Page, cell: Cell) -> None:
    cell.services["executor"].kill()
    expect(page.get_by_text("no joint states")).to_be_visible()
    again = ServiceProcess("executor", cell.endpoint, cell.folder)
    cell.stack.enter_context(again).wait_ready(cell.bus, KEYS)
    expect(page.get_by_text("no joint states")).to_be_hidden()


def test_on_a_phone_the_stop_is_in_reach(page: Page, cell: Cell, chromium: Browser) -> None:
    phone = opened(chromium, cell.address, (390, 844))
    expect(phone.get_by_text("STOP").first).to_be_in_viewport()
    phone.close()
