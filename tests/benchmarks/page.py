"""What the page costs while the robot moves, `python tests/benchmarks/page.py`: the viewer's share of a core and bytes a second for each page; ticks beside it.

A page is a WebSocket client that reads what a browser would; 100 000 voxels are in the scene.
"""

from __future__ import annotations

import socket
import sys
import tempfile
import threading
import time
from contextlib import ExitStack
from pathlib import Path

import psutil
import viser
from rich.console import Console
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import ClientConnection, connect

import zarm

sys.path.insert(0, str(Path(__file__).parents[1]))

from support.harness import ServiceProcess, eventually, router
from support.trajectories import HOME, KEYS
from zarm_runtime.bus import Bus

SECONDS = 8.0
PAGES = (0, 1, 5)


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


def main() -> None:
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        endpoint = stack.enter_context(router())
        bus = stack.enter_context(Bus(endpoint))
        for service in ("planner", "executor"):
            stack.enter_context(ServiceProcess(service, endpoint, folder)).wait_ready(bus, KEYS)
        robot = stack.enter_context(zarm.connect(endpoint))
        cells = [(x + 150, y - 50, z - 20) for x in range(100) for y in range(100) for z in range(10)]
        robot.scene.add(zarm.Voxels("cloud", resolution=0.01, cells=cells))
        with socket.create_server(("127.0.0.1", 0)) as probe:
            address = f"127.0.0.1:{probe.getsockname()[1]}"
        viewer = stack.enter_context(ServiceProcess("viewer", endpoint, folder, arguments=("--listen", address)))
        eventually(lambda: "ready" in viewer.output(), "the page is served")
        process = psutil.Process(viewer.process.pid)
        for pages in PAGES:
            readers = [Reader(address) for _ in range(pages)]
            time.sleep(2.0)  # the pages are filled
            first, missed = [reader.bytes for reader in readers], robot.state().missed_ticks
            used, began = process.cpu_times(), time.monotonic()
            ends = ((0.8, *HOME[1:]), HOME)
            count = 0
            while time.monotonic() - began < SECONDS:
                robot.execute(robot.plan(ends[count % 2], velocity_scale=0.5))
                count += 1
            took, now = time.monotonic() - began, process.cpu_times()
            share = (now.user + now.system - used.user - used.system) / took
            sent = (
                sum(reader.bytes - start for reader, start in zip(readers, first, strict=True)) / max(pages, 1) / took
            )
            ticks = robot.state().missed_ticks - missed
            Console().print(
                f"{pages} pages: viewer {share:.0%} of a core, {sent / 1e3:.0f} kB/s a page, filled with "
                f"{max(first, default=0) / 1e6:.2f} MB, {ticks} ticks missed"
            )
            for reader in readers:
                reader.close()


if __name__ == "__main__":
    main()
