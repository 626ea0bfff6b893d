"""The page of a robot with two arms: the group that is chosen is aimed with, and jogged."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import ExitStack

import numpy as np
import pytest
from playwright.sync_api import Browser, Page, expect

import zarm
from support.composed import two_pandas
from support.harness import ServiceProcess, eventually, router
from support.viewer import free_port, opened
from zarm_contract.keys import Keys
from zarm_runtime.bus import Bus

LEFT, RIGHT = slice(7), slice(7, 14)


class Cell:
    """Two Pandas, all their processes, and the address of their page."""

    def __init__(self, stack: ExitStack, tmp_path_factory: pytest.TempPathFactory) -> None:
        folder, robot = tmp_path_factory.mktemp("cell"), str(two_pandas(tmp_path_factory.mktemp("robot")))
        endpoint = stack.enter_context(router())
        bus = stack.enter_context(Bus(endpoint))
        for service in ("planner", "executor", "servo"):
            process = ServiceProcess(service, endpoint, folder, robot)
            stack.enter_context(process).wait_ready(bus, Keys("pandas"))
        self.robot = stack.enter_context(zarm.connect(endpoint))
        arguments = ("--listen", f"127.0.0.1:{free_port()}")
        viewer = stack.enter_context(ServiceProcess("viewer", endpoint, folder, robot, arguments=arguments))
        served = eventually(lambda: re.search(r"^http://\S+$", viewer.output(), re.MULTILINE), "the page is served")
        self.address = served[0]

    def joints(self) -> np.ndarray:  # type: ignore[type-arg]
        return np.array(self.robot.joint_state().position)


@pytest.fixture(scope="module")
def cell(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cell]:
    with ExitStack() as stack:
        yield Cell(stack, tmp_path_factory)


@pytest.fixture
def page(chromium: Browser, cell: Cell) -> Iterator[Page]:
    page = opened(chromium, cell.address)
    page.get_by_role("tab", name="Move").click()
    yield page
    page.close()


def choose_group(page: Page, group: str) -> None:
    page.get_by_role("combobox", name="group").click()
    page.get_by_role("option", name=group, exact=True).click()


@pytest.mark.slow  # as the drawing is
def test_the_tip_of_the_chosen_group_is_jogged(page: Page, cell: Cell) -> None:
    choose_group(page, "right")
    before, start = cell.joints(), cell.robot.tip("right").position
    page.get_by_role("tab", name="Jog").click()
    button = page.get_by_role("button", name="+ z")
    button.scroll_into_view_if_needed()
    button.hover()
    page.mouse.down()
    eventually(lambda: cell.robot.tip("right").position[2] > start[2] + 0.01, "the right tip goes up")
    page.mouse.up()
    assert np.abs(cell.joints()[LEFT] - before[LEFT]).max() < 1e-6
    eventually(lambda: cell.robot.state().mode == "idle", "the session has ended")


@pytest.mark.slow  # as the drawing is
def test_a_goal_of_all_joints_moves_both_arms(page: Page, cell: Cell) -> None:
    cell.robot.execute(cell.robot.plan(tuple((cell.joints() + 0.2).tolist())))
    choose_group(page, "left")
    page.get_by_text("Poses").click()
    page.get_by_role("button", name="Home").click()
    expect(page.get_by_text("reachable, free")).to_be_visible()
    page.get_by_role("button", name="Plan and execute").click()
    home = np.tile((0.0, -0.785398, 0.0, -2.356194, 0.0, 1.570796, 0.785398), 2)
    eventually(lambda: np.abs(cell.joints() - home).max() < 1e-3, "both arms are at home")
