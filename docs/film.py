"""The film of the README: `python docs/film.py [--record FILE]` makes `demo.webp` in `docs/images/`, with Chromium.

It plays a record of `zarm demo --physics`, which it makes first unless one is given, and takes its pictures one after the other, so that the
machine may be slow.
"""

from __future__ import annotations

import argparse
import shutil
import socket
import tempfile
import threading
import time
from pathlib import Path

import numpy as np
from PIL import Image
from playwright.sync_api import sync_playwright
from screenshot import ARGUMENTS, IMAGES, PATIENCE

from zarm_cli.demo_physics import MAP, PANDA, WORLD, show
from zarm_cli.launcher import SimulatedDriver, launch
from zarm_contract.robot import load_robot
from zarm_viewer.gate import Gate
from zarm_viewer.page import Folders, Page, Shown
from zarm_viewer.playback import Playback

SIZE = 640, 400
SECONDS, RATE = 20.0, 10
"""Length (s) of the film, and its pictures per second."""
SWERVE, SHOWN = 3.5, 8.0
"""s at the end of the record, in which the arm swerves, and s of the film in which they are shown; the rest is faster."""
FROM, AT = (1.35, -0.7, 0.8), (0.4, 0.05, 0.22)
"""Where the camera of the film is, and what it looks at (m)."""
_SETTLED = 0.3
"""s in which the page draws what is new."""


def main() -> None:
    """Make the record and the film."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--record", type=Path)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        record = options.record or Path(folder) / "demo.mcap"
        if not record.exists():
            make(record, Path(folder))
        pictures = play(record, Path(folder))
    first, *others = [Image.fromarray(picture) for picture in pictures]
    file = IMAGES / "demo.webp"
    first.save(file, save_all=True, append_images=others, duration=1000 // RATE, loop=0, quality=50, method=6)


def make(record: Path, state: Path) -> None:
    """Record the demo with its scene, map and simulation."""
    with launch(
        PANDA,
        strategy=None,
        driver=SimulatedDriver.physics,
        physics=WORLD,
        perception=MAP,
        listen=f"tcp/127.0.0.1:{free_port()}",
        state=state,
        log_level="WARNING",
        view=None,
    ) as stack:
        stack.wait_ready(lambda _: None)
        with stack.client.record(record, scene=True):
            show(stack.client)


def play(record: Path, state: Path) -> list[np.ndarray]:
    """The pictures of the film."""
    playback = Playback(record)
    playback.pause()
    gate = Gate.at(f"127.0.0.1:{free_port()}")
    page = Page([Shown(playback, load_robot(PANDA))], gate, "viewer", Folders((), state, state))
    opened = threading.Event()
    page.server.on_client_connect(lambda _: opened.set())
    pictures = []
    try:
        with sync_playwright() as playwright:
            browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=ARGUMENTS)
            browser.new_page(viewport={"width": 1000, "height": 700}).goto(page.address)
            opened.wait(PATIENCE / 1e3)
            (client,) = page.server.get_clients().values()
            client.camera.position, client.camera.look_at = FROM, AT
            for at in moments(playback.story.lasted).tolist():
                playback.seek(at)
                time.sleep(_SETTLED)
                pictures.append(client.get_render(SIZE[1], SIZE[0], timeout=PATIENCE / 1e3))
            browser.close()
    finally:
        page.close()
    return pictures


def moments(lasted: float) -> np.ndarray:
    """The times (s) of the pictures in a record that `lasted` s."""
    slow = int(SHOWN * RATE)
    fast = np.linspace(0.0, lasted - SWERVE, int(SECONDS * RATE) - slow, endpoint=False)
    return np.concatenate((fast, np.linspace(lasted - SWERVE, lasted, slow)))


def free_port() -> int:
    """A port that nobody listens on."""
    with socket.create_server(("127.0.0.1", 0)) as probe:
        return int(probe.getsockname()[1])


if __name__ == "__main__":
    main()
