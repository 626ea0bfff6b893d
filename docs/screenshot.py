"""The picture of the page for README and guide: `python docs/screenshot.py` makes `docs/images/page.png`, with Chromium."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from playwright.sync_api import expect, sync_playwright

FILE = Path(__file__).parent / "images" / "page.png"
PATIENCE = 120e3
ARGUMENTS = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]


def main() -> None:
    """Play the demo on the page, aim at another goal, plan, and take the picture."""
    script = "import sys; from zarm_cli.app import main; sys.argv[1:] = ['demo', '--view']; main()"
    command = [sys.executable, "-c", script]
    with tempfile.TemporaryFile("w+") as log:
        demo = subprocess.Popen(command, stdout=log, stderr=log, start_new_session=True)  # noqa: S603
        try:
            address = ""
            while not (found := re.search(r"http://\S+", address)) or "stays open" not in address:
                if demo.poll() is not None:
                    sys.exit(address)
                log.seek(0)
                address = log.read()
            with sync_playwright() as playwright:
                browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=ARGUMENTS)
                page = browser.new_page(viewport={"width": 1280, "height": 800})
                page.goto(found[0])
                expect(page.get_by_text("idle").first).to_be_visible(timeout=PATIENCE)
                page.get_by_text("Poses").click()
                page.get_by_role("button", name="Home").click()
                expect(page.get_by_text("reachable")).to_be_visible(timeout=PATIENCE)
                page.get_by_text("Poses").click()
                page.get_by_role("button", name="Plan", exact=True).click()
                expect(page.get_by_text("clearance")).to_be_visible(timeout=PATIENCE)
                for close in page.get_by_role("alert").get_by_role("button").all():
                    close.click()
                page.wait_for_timeout(3000)  # the ghost has played, and the picture is drawn
                page.screenshot(path=FILE, timeout=PATIENCE, animations="disabled")
                browser.close()
        finally:
            demo.terminate()
            demo.wait()


if __name__ == "__main__":
    main()
