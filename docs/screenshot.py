"""The pictures of the page for README and guide: `python docs/screenshot.py` makes `page.png` and `page.webp` in `docs/images/`, with Chromium."""

from __future__ import annotations

import io
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from PIL import Image
from playwright.sync_api import Page, expect, sync_playwright

IMAGES = Path(__file__).parent / "images"
PATIENCE = 120e3
"""ms for whatever is waited for."""
ARGUMENTS = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
SIZE, SMALL = (1280, 800), (832, 520)
PLAYS, LAST = 4000, 2000
"""ms for which the animation plays, however many pictures this machine has taken, and for which the last one stays."""
SLOW = 2
"""Steps of the speed slider above its least: pictures are taken one after the other while the robot moves so slowly."""


def main() -> None:
    """Play the demo on the page, aim at another goal and plan: the picture; execute it: the animation."""
    with demo() as address, sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=ARGUMENTS)
        page = browser.new_page(viewport={"width": SIZE[0], "height": SIZE[1]})
        page.goto(address)
        expect(page.get_by_text("idle").first).to_be_visible(timeout=PATIENCE)
        frames = [shot(page)]
        page.get_by_text("Poses").click()
        page.get_by_role("button", name="Home").click()
        expect(page.get_by_text("reachable")).to_be_visible(timeout=PATIENCE)
        page.get_by_text("Poses").click()
        frames.append(shot(page))
        page.get_by_role("button", name="Plan", exact=True).click()
        expect(page.get_by_text("clearance")).to_be_visible(timeout=PATIENCE)
        for close in page.get_by_role("alert").get_by_role("button").all():
            close.click()
        page.wait_for_timeout(3000)  # the ghost has played, and the picture is drawn
        page.screenshot(path=IMAGES / "page.png", timeout=PATIENCE, animations="disabled")
        speed = page.get_by_role("slider").nth(1)
        speed.press("Home")
        for _ in range(SLOW):
            speed.press("ArrowRight")
        page.get_by_role("button", name="Execute", exact=True).click()
        expect(page.get_by_text("running").first).to_be_visible(timeout=PATIENCE)
        while page.get_by_text("running").first.is_visible():
            frames.append(shot(page))
        frames.append(shot(page))
        browser.close()
    durations = [PLAYS // len(frames)] * (len(frames) - 1) + [LAST]
    frames[0].save(
        IMAGES / "page.webp", save_all=True, append_images=frames[1:], duration=durations, loop=0, quality=55, method=6
    )


@contextmanager
def demo() -> Iterator[str]:
    """`zarm demo --view`, until the block ends; the address of its page."""
    script = "import sys; from zarm_cli.app import main; sys.argv[1:] = ['demo', '--view']; main()"
    with tempfile.TemporaryFile("w+") as log:
        process = subprocess.Popen(  # noqa: S603
            [sys.executable, "-c", script], stdout=log, stderr=log, start_new_session=True
        )
        try:
            said, until = "", time.monotonic() + PATIENCE / 1e3
            while not (found := re.search(r"http://\S+", said)) or "stays open" not in said:
                if process.poll() is not None or time.monotonic() > until:
                    sys.exit(f"the demo has not come to its end:\n{said}")
                time.sleep(0.1)
                log.seek(0)
                said = log.read()
            yield found[0]
        finally:
            process.terminate()
            process.wait()


def shot(page: Page) -> Image.Image:
    """The page now, small."""
    picture = page.screenshot(timeout=PATIENCE, animations="disabled", type="jpeg", quality=95)
    return Image.open(io.BytesIO(picture)).convert("RGB").resize(SMALL, Image.Resampling.LANCZOS)


if __name__ == "__main__":
    main()
