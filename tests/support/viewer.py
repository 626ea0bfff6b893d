"""A robot with its processes, and pages that show it."""

from __future__ import annotations

import re
import socket
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import numpy as np
from playwright.sync_api import Browser, Page, expect

import zarm
from support.browser import pixel
from support.harness import PATIENCE, ServiceProcess, eventually, free_endpoint
from support.trajectories import HOME, KEYS, ROBOT
from zarm_runtime.bus import Bus
from zarm_runtime.session import open_router

SIZE = (1000, 640)
"""Width and height (px) of a page: small, because it is drawn without a GPU."""
COARSE = 0.5
"""Device pixels per CSS pixel, few for the same reason."""
PANEL = 388
"""Width (px) of the panels beside the 3D view."""
expect.set_options(timeout=PATIENCE * 1e3)


class Cell:
    """One robot with planner, executor and servo, behind a router that can be started again."""

    def __init__(self, stack: ExitStack, folder: Path, *services: str) -> None:
        self.stack, self.folder = stack, folder
        self.endpoint = free_endpoint()
        self.open_router()
        stack.callback(lambda: self.router.close())
        self.bus = stack.enter_context(Bus(self.endpoint))
        self.services = {service: self.begin(service) for service in services}
        for process in self.services.values():
            process.wait_ready(self.bus, KEYS)
        self.robot = stack.enter_context(zarm.connect(self.endpoint, ROBOT.descriptor.name))

    def open_router(self) -> None:
        """A router in this process."""
        self.router = open_router(self.endpoint)

    def begin(self, service: str, robot: str = ROBOT.descriptor.name, name: str | None = None) -> ServiceProcess:
        """Start a service."""
        return self.stack.enter_context(ServiceProcess(service, self.endpoint, self.folder, robot, name))

    def serve(self, *arguments: str, script: Path | None = None, **environment: str) -> str:
        """The address of a viewer started with these arguments; `viewer` is its process."""
        self.viewer = viewer = ServiceProcess(
            "viewer",
            self.endpoint,
            self.folder,
            arguments=("--listen", f"127.0.0.1:{free_port()}", *arguments),
            script=str(script) if script else None,
            environment=environment,
        )
        self.stack.enter_context(viewer)

        def served() -> re.Match[str] | None:
            assert viewer.process.poll() is None, viewer.output()
            return re.search(r"^https?://\S+$", viewer.output(), re.MULTILINE)

        return eventually(served, "the page is served")[0]

    def rests(self) -> bool:
        """Whether the robot is idle, and stands still."""
        return self.robot.state().mode == "idle" and max(map(abs, self.robot.joint_state().velocity)) < 1e-4

    def home(self) -> None:
        """Bring the robot to rest at home, in an empty scene."""
        self.robot.stop()
        eventually(self.rests, "the robot rests")
        self.robot.scene.clear()
        if not np.allclose(self.robot.joint_state().position, HOME, atol=1e-3):
            self.robot.execute(self.robot.plan(HOME))

    def tip_pixel(self) -> tuple[float, float]:
        """The pixel of the tip on the page, by its pose on the bus."""
        return self.pixel(self.robot.tip().position)

    def pixel(self, point: tuple[float, ...]) -> tuple[float, float]:
        """The pixel of a scene point (m) on a page of `SIZE` with the initial camera."""
        return pixel(point, SIZE[0] - PANEL, SIZE[1])


def free_port() -> int:
    """A port that was free a moment ago."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@contextmanager
def cell_of(folder: Path, *services: str) -> Iterator[Cell]:
    """A cell, until the block ends."""
    with ExitStack() as stack:
        yield Cell(stack, folder, *services)


def opened(chromium: Browser, address: str, size: tuple[int, int] = SIZE) -> Page:
    """An open page in the browser."""
    page = chromium.new_page(
        viewport={"width": size[0], "height": size[1]}, device_scale_factor=COARSE, ignore_https_errors=True
    )
    page.goto(address)
    expect(page.get_by_text("STOP").first).to_be_visible()
    return page


def drawn_tip(page: Page, robot: str = ROBOT.descriptor.name) -> tuple[float, ...] | None:
    """The tip's position (m) in the page's scene graph, in the robot's base frame; None if it is not there yet."""
    return _drawn(page, robot, "robot", "tip_axes")


def drawn_link(page: Page, robot: str, link: str) -> tuple[float, ...] | None:
    """The position (m) of a link in the page's scene graph, in the robot's base frame."""
    return _drawn(page, robot, "robot", link)


def drawn_ghost(page: Page) -> tuple[float, ...] | None:
    """The position (m) of the tip of the goal's ghost in the scene graph, in the robot's base frame."""
    return _drawn(page, ROBOT.descriptor.name, "goal_ghost", ROBOT.descriptor.tip_link)


def drawn_width(page: Page) -> float:
    """How far the frames of the links are from the middle of the view at most: 0 none is there yet, 1 at its edge."""
    return float(page.evaluate(_WIDTH, f"/{ROBOT.descriptor.name}/robot/"))


def _drawn(page: Page, robot: str, arm: str, node: str) -> tuple[float, ...] | None:
    found = page.evaluate(_PLACE, [f"/{robot}", arm, node])
    return None if found is None else tuple(found)


_PLACE = """([root, arm, node]) => {
    const nodes = window.__viserMutable?.nodeRefFromName ?? {};
    const found = nodes[Object.keys(nodes).find(name => name.startsWith(`${root}/${arm}/`) && name.endsWith(`/${node}`))];
    const base = nodes[root];
    if (!found || !base) return null;
    base.updateWorldMatrix(true, false);
    found.updateWorldMatrix(true, false);
    return base.matrixWorld.clone().invert().multiply(found.matrixWorld).elements.slice(12, 15);
}"""
_WIDTH = """root => {
    const {nodeRefFromName: nodes, camera} = window.__viserMutable ?? {nodeRefFromName: {}};
    const frames = Object.keys(nodes).filter(name => name.startsWith(root)).map(name => nodes[name]).filter(node => node?.parent);
    camera?.updateMatrixWorld();
    return Math.max(0, ...frames.map(node => {
        node.updateWorldMatrix(true, false);
        return Math.abs(node.position.clone().setFromMatrixPosition(node.matrixWorld).project(camera).x);
    }));
}"""
