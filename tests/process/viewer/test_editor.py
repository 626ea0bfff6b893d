"""`zarm robot edit` in a real browser: what is corrected on the page is in the descriptor after Save, and is looked at again."""

from __future__ import annotations

import re
import shutil
import signal
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Browser, Page, expect

from support.command_line import ZARM, environment
from support.harness import PATIENCE, eventually
from support.viewer import SIZE, free_port
from zarm_contract.robot import ROBOTS, load_robot

pytestmark = pytest.mark.timed  # Chromium draws in software
LINK = "base_link_inertia"
RADIUS = 4
"""Its number among those of the tab: the sphere, its centre and its radius."""


@pytest.fixture
def file(tmp_path: Path) -> Path:
    for suffix in (".urdf", ".yaml"):
        shutil.copy(ROBOTS / f"ur5e{suffix}", tmp_path)
    return tmp_path / "ur5e.yaml"


@pytest.fixture
def page(chromium: Browser, file: Path, tmp_path: Path) -> Iterator[Page]:
    log = tmp_path / "editor.log"
    with log.open("wb") as output:
        command = [ZARM, "robot", "edit", str(file), "--listen", f"127.0.0.1:{free_port()}"]
        editor = subprocess.Popen(command, stdout=output, stderr=output, env=environment())
    try:

        def served() -> re.Match[str] | None:
            assert editor.poll() is None, log.read_text()
            return re.search(r"^http://\S+$", log.read_text(), re.MULTILINE)

        address = eventually(served, "the page is served")[0]
        opened = chromium.new_page(viewport={"width": SIZE[0], "height": SIZE[1]})
        opened.goto(address)
        expect(opened.get_by_role("button", name="Save")).to_be_visible()
        yield opened
        opened.close()
        editor.send_signal(signal.SIGINT)
        assert editor.wait(PATIENCE) == 0
    finally:
        editor.kill()
        editor.wait()


def enter(page: Page, number: int, value: str) -> None:
    """Type a value into one of the numbers of the open tab."""
    field = page.get_by_role("textbox").nth(number)
    field.fill(value)
    field.press("Enter")


@pytest.mark.slow
def test_spheres_pairs_and_home_are_corrected_and_saved(page: Page, file: Path) -> None:
    before = load_robot(str(file)).descriptor
    enter(page, RADIUS, "0.0912")
    page.get_by_role("button", name="Add one like it").click()
    enter(page, RADIUS - 1, "0.1234")
    page.get_by_role("tab", name="Pairs").click()
    page.get_by_role("checkbox", name="wrist_1_link, wrist_3_link").click()
    page.get_by_role("checkbox", name="shoulder_link, forearm_link").click()
    page.get_by_role("tab", name="Home").click()
    enter(page, 2, "1.7")
    page.get_by_role("button", name="Save").click()
    expect(page.get_by_text("Saved.").first).to_be_visible()
    after = load_robot(str(file)).descriptor
    first, *rest = before.spheres[LINK]
    bigger = first.model_copy(update={"radius": 0.0912})
    x, y, _ = first.center
    added = bigger.model_copy(update={"center": (x, y, 0.1234)})
    assert after.spheres == {**before.spheres, LINK: (bigger, *rest, added)}
    ignored = [pair for pair in before.self_collision_ignore if pair != ("wrist_1_link", "wrist_3_link")]
    assert after.self_collision_ignore == (*ignored, ("shoulder_link", "forearm_link"))
    assert after.home == (*before.home[:2], 1.7, *before.home[3:])
    assert after.collision == before.collision
    expect(page.get_by_text(f"spheres.{LINK}[1]: it stands out of the link")).to_be_visible()
