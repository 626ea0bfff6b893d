"""One browser for all tests of the page, and for each module a robot and pages that show it."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from playwright.sync_api import Browser, Page

from support.browser import CHROMIUM, browser
from support.viewer import Cell, cell_of, opened


@pytest.fixture(scope="package")
def chromium() -> Iterator[Browser]:
    """Debian's Chromium."""
    if CHROMIUM is None:
        pytest.skip("no chromium here; `apt-get install chromium` brings it")
    with browser() as started:
        yield started


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
