"""What the page costs while the robot moves, `python tests/benchmarks/page.py`: the viewer's share of a core; for each page, bytes a
second and how far apart the robot's poses arrive; ticks beside it; and how long it takes from a drag of the handle to the ghost.

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
from collections import Counter
from contextlib import ExitStack, suppress
from pathlib import Path

import msgspec
import numpy as np
import psutil
import viser
import zstandard
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
OPENED, SETTLED = 3, 3.0
"""So many pages are opened, and looked at for so long (s) when the robot is there."""
DRAGS, STEP = 200, 0.002
"""So many drags of the handle, each by so many m."""
CAMERA = {
    "type": "ViewerCameraMessage", "wxyz": (1.0, 0.0, 0.0, 0.0), "position": (1.5, -0.8, 1.1), "look_at": (0.3, 0.1, 0.4),
    "up_direction": (0.0, 0.0, 1.0), "fov": 1.3, "image_width": 1280, "image_height": 800, "near": 0.01, "far": 1000.0,
}  # fmt: skip
DRAWN = "() => Object.keys(window.__viserMutable?.nodeRefFromName ?? {}).some(name => name.endsWith('/tip_axes'))"


def connected(address: str) -> ClientConnection:
    """As a page is."""
    protocol = [f"viser-v{viser.__version__}"]
    return connect(f"ws://{address}/", subprotocols=protocol, max_size=None)  # type: ignore[arg-type]


class Reader:
    """A page that reads all that it is sent; for viser it is one when it has told how it looks at the scene."""

    def __init__(self, address: str) -> None:
        self._socket = connected(address)
        self._socket.send(msgspec.msgpack.encode(CAMERA))
        self.frames: list[tuple[float, str | bytes]] = []
        threading.Thread(target=self._read, daemon=True).start()

    def _read(self) -> None:
        try:
            for frame in self._socket:
                self.frames.append((time.monotonic(), frame))
        except ConnectionClosed:
            return

    def intervals(self, since: float) -> list[float]:
        """The time (s) between one pose of the robot's first link and the next, since a moment (s, monotonic)."""
        poses = [at for at, frame in self.frames if at > since and f"/{KEYS.robot}/robot/link_1" in turned(frame)]
        return np.diff(poses).tolist()

    @property
    def bytes(self) -> int:
        """So many were sent to it."""
        return sum(len(frame) for _, frame in self.frames)

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
    """How long it takes from the address to the Stop button, and to the robot in the scene; and what it costs until both are drawn."""
    with browser() as chromium:
        for count in range(OPENED):
            page, used, began = chromium.new_page(), of_chromium(), time.monotonic()
            page.goto(f"http://{address}/")
            page.get_by_text("STOP").first.wait_for()
            usable = time.monotonic() - began
            page.wait_for_function(DRAWN)
            drawn = time.monotonic() - began
            time.sleep(SETTLED)
            cost = {kind: seconds - used[kind] for kind, seconds in of_chromium().items()}
            Console().print(
                f"page {count + 1} opened: Stop after {usable:.1f} s, the robot after {drawn:.1f} s; "
                f"{cost['renderer']:.1f} s of CPU for the page, {cost['gpu-process']:.1f} s for drawing"
            )
            page.close()


def of_chromium() -> Counter[str]:
    """The CPU time (s) that the processes of Chromium have used, by their kind."""
    used: Counter[str] = Counter()
    for process in psutil.Process().children(recursive=True):
        with suppress(psutil.Error):
            kinds = [word.removeprefix("--type=") for word in process.cmdline() if word.startswith("--type=")]
            times = process.cpu_times()
            used.update(dict.fromkeys(kinds, times.user + times.system))
    return used


def dragging(address: str, tip: zarm.Pose) -> None:
    """How long it takes from a drag of the handle, sent by a page, until the page is sent the ghost there."""
    handle, took = f"/{KEYS.robot}/goal", []
    x, y, z, w = tip.orientation
    with connected(address) as page:
        drain(page, 1.0)
        for count in range(DRAGS):
            at = (tip.position[0], tip.position[1], tip.position[2] - STEP * (1 + count % 50))
            drag = {"type": "TransformControlsUpdateMessage", "name": handle, "wxyz": (w, x, y, z), "position": at}
            began = time.monotonic()
            page.send(msgspec.msgpack.encode(drag))
            while not any(name.startswith(f"{handle}_ghost/") for name in turned(page.recv(timeout=10.0))):
                pass
            took.append(1e3 * (time.monotonic() - began))
            drain(page, 0.1)
    late = np.percentile(took[DRAGS // 10 :], (50, 95, 100))
    Console().print("from a drag to the ghost: {:.0f} ms, p95 {:.0f} ms, at most {:.0f} ms".format(*late))


def drain(page: ClientConnection, quiet: float) -> None:
    """Read until nothing comes for so long (s)."""
    with suppress(TimeoutError):
        while True:
            page.recv(timeout=quiet)


def turned(frame: str | bytes) -> list[str]:
    """The nodes whose orientation a frame sets; `_message_producer` of viser says how it is written."""
    if isinstance(frame, str):
        raise TypeError("viser sends bytes")
    size, packed = (int.from_bytes(frame[at : at + 8], "little") for at in (0, 8))
    reported = msgspec.msgpack.decode(zstandard.decompress(frame[16 : 16 + packed], max_output_size=size))
    return [each["name"] for each in reported["messages"] if each["type"] == "SetOrientationMessage"]


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
        dragging(address, robot.tip())
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
            intervals = [1e3 * apart for reader in readers for apart in reader.intervals(began)]
            ticks = robot.state().missed_ticks - missed
            (count, late), (count_before, late_before) = lateness(metrics), before
            Console().print(
                f"{pages} pages: viewer {share:.0%} of a core, {sent / 1e3:.0f} kB/s a page, filled with "
                f"{max(first, default=0) / 1e6:.2f} MB, {ticks} of "
                f"{count - count_before:.0f} ticks missed, {1e6 * (late - late_before) / (count - count_before):.0f} us late on average"
                + (f"; poses {np.median(intervals):.0f} ms apart" if intervals else "")
            )
            for reader in readers:
                reader.close()


if __name__ == "__main__":
    main()
