"""What the page costs while the robot moves, `python tests/benchmarks/page.py`: the viewer's share of a core and bytes a second for each page; ticks beside it.

A page is a WebSocket client that reads what a browser would; 100 000 voxels are in the scene. How soon a page is opened
is seen in Chromium, before those are there.
"""

from __future__ import annotations

import socket
import sys
import tempfile
import threading
import time
import urllib.request
from contextlib import ExitStack
from pathlib import Path

import psutil
import viser
from rich.console import Console
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import ClientConnection, connect

import zarm

sys.path.insert(0, str(Path(__file__).parents[1]))

from support.browser import CHROMIUM, browser
from support.harness import ServiceProcess, eventually, router
from support.trajectories import HOME, KEYS
from zarm_runtime.bus import Bus

SECONDS = 8.0
PAGES = (0, 1, 5)
OPENED = 3
DRAWN = "() => Object.keys(window.__viserMutable?.nodeRefFromName ?? {}).some(name => name.endsWith('/tip_axes'))"


class Reader:
    """A page that reads all that it is sent."""

    def __init__(self, address: str) -> None:
        protocol = [f"viser-v{viser.__version__}"]
        self._socket: ClientConnection = connect(f"ws://{address}/", subprotocols=protocol, max_size=None)  # type: ignore[arg-type]
        self.bytes = 0
        threading.Thread(target=self._read, daemon=True).start()

    def _read(self) -> None:
        try:
            for frame in self._socket:
                self.bytes += len(frame)
        except ConnectionClosed:
            return

    def close(self) -> None:
        self._socket.close()


def free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as probe:
        return int(probe.getsockname()[1])


def lateness(metrics: str) -> tuple[float, float]:
    """How many ticks the executor has had, and how late (s) all of them were together."""
    with urllib.request.urlopen(f"http://{metrics}/metrics", timeout=5) as answer:
        lines = [line.split() for line in answer.read().decode().splitlines() if line.startswith("zarm_tick_lateness")]
    values = {name.partition("{")[0]: float(value) for name, value in lines}
    return values["zarm_tick_lateness_seconds_count"], values["zarm_tick_lateness_seconds_sum"]


def opening(address: str) -> None:
    """How long it takes from the address to the Stop button, and to the robot in the scene."""
    with browser() as chromium:
        for count in range(OPENED):
            page, began = chromium.new_page(), time.monotonic()
            page.goto(f"http://{address}/")
            page.get_by_text("STOP").first.wait_for()
            usable = time.monotonic() - began
            page.wait_for_function(DRAWN)
            drawn = time.monotonic() - began
            Console().print(f"page {count + 1} opened: Stop after {usable:.1f} s, the robot after {drawn:.1f} s")
            page.close()


def main() -> None:
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        endpoint = stack.enter_context(router())
        bus = stack.enter_context(Bus(endpoint))
        metrics = f"127.0.0.1:{free_port()}"
        for service, arguments in (("planner", ()), ("executor", ("--metrics", metrics))):
            process = ServiceProcess(service, endpoint, folder, arguments=arguments)
            stack.enter_context(process).wait_ready(bus, KEYS)
        robot = stack.enter_context(zarm.connect(endpoint))
        address = f"127.0.0.1:{free_port()}"
        viewer = stack.enter_context(ServiceProcess("viewer", endpoint, folder, arguments=("--listen", address)))
        eventually(lambda: "ready" in viewer.output(), "the page is served")
        if CHROMIUM is not None:
            opening(address)
        cells = [(x + 150, y - 50, z - 20) for x in range(100) for y in range(100) for z in range(10)]
        robot.scene.add(zarm.Voxels("cloud", resolution=0.01, cells=cells))
        usage = psutil.Process(viewer.process.pid)
        for pages in PAGES:
            readers = [Reader(address) for _ in range(pages)]
            time.sleep(2.0)  # the pages are filled
            first, missed = [reader.bytes for reader in readers], robot.state().missed_ticks
            before = lateness(metrics)
            used, began = usage.cpu_times(), time.monotonic()
            ends = ((0.8, *HOME[1:]), HOME)
            goals = 0
            while time.monotonic() - began < SECONDS:
                robot.execute(robot.plan(ends[goals % 2], velocity_scale=0.5))
                goals += 1
            took, now = time.monotonic() - began, usage.cpu_times()
            share = (now.user + now.system - used.user - used.system) / took
            sent = (
                sum(reader.bytes - start for reader, start in zip(readers, first, strict=True)) / max(pages, 1) / took
            )
            ticks = robot.state().missed_ticks - missed
            (count, late), (count_before, late_before) = lateness(metrics), before
            Console().print(
                f"{pages} pages: viewer {share:.0%} of a core, {sent / 1e3:.0f} kB/s a page, filled with "
                f"{max(first, default=0) / 1e6:.2f} MB, {ticks} of "
                f"{count - count_before:.0f} ticks missed, {1e6 * (late - late_before) / (count - count_before):.0f} us late on average"
            )
            for reader in readers:
                reader.close()


if __name__ == "__main__":
    main()
