"""Jogging on the page in a real browser: a dead man's switch."""

from __future__ import annotations

import os
import signal

import pytest
from playwright.sync_api import Browser, Page

from support.harness import PATIENCE, eventually
from support.trajectories import HOME
from support.viewer import Cell, opened

# Who jogs keeps the robot as long as their page asks 7 times a second, which the browser draws in software.
pytestmark = pytest.mark.timed


def hold(page: Page, label: str) -> None:
    """Press a button of the page and keep it pressed."""
    button = page.get_by_role("button", name=label)
    button.scroll_into_view_if_needed()
    box = button.bounding_box()
    assert box is not None
    page.mouse.up()
    page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    page.mouse.down()


def test_who_jogs_has_the_robot_and_it_rests_when_their_page_is_lost(
    page: Page, cell: Cell, chromium: Browser, address: str, second: Page
) -> None:
    for each in (page, second):
        each.get_by_role("tab", name="Jog").click()
    start = cell.robot.tip().position
    hold(second, "+ x")
    eventually(lambda: abs(cell.robot.tip().position[0] - start[0]) > 0.01, "it moves as long as the button is held")
    told = [each.get_by_text("Somebody else jogs").first for each in (page, second)]

    def one_is_told() -> bool:
        if cell.rests():  # a page that was held up has let go
            hold(second, "+ x")
        hold(page, "− x")
        return any(each.is_visible() for each in told)

    eventually(one_is_told, "who does not have the robot is told")
    page.mouse.up()
    second.goto("about:blank")
    eventually(cell.rests, "the robot rests")


def test_jogging_ends_and_a_goal_goes_on_while_the_viewer_stands_still_and_when_it_is_killed(
    page: Page, cell: Cell, chromium: Browser
) -> None:
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
