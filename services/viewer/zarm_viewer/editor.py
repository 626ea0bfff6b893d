"""The process behind `zarm robot edit`: a page to correct and save a robot's spheres, link pairs and home."""

from __future__ import annotations

import argparse
import logging
import sys
from collections.abc import Callable
from itertools import combinations
from typing import Any

import numpy as np
import viser
from viser import GuiEvent, Icon, MeshHandle, TransformControlsEvent, TransformControlsHandle
from viser.transforms import SE3

from zarm_contract.collision import CollisionSphere
from zarm_contract.errors import ZarmError
from zarm_contract.robot import RobotDescription, load_robot
from zarm_runtime import signals
from zarm_runtime.logs import setup_logging
from zarm_viewer.arm import SPHERES, Arm
from zarm_viewer.body import body_of
from zarm_viewer.controls import put
from zarm_viewer.corrections import Corrections
from zarm_viewer.drawing import Brush, link_mesh
from zarm_viewer.environment import add_environment
from zarm_viewer.gate import Gate

log = logging.getLogger(__name__)

CHOSEN = (230, 73, 128)
LINKS = (148, 163, 184)
SMALLEST = 0.001
"""Least radius (m) of a sphere."""
STEP = 1e-4
"""Centres, radii (m) and home joints (rad) are corrected in multiples of this."""
DIGITS = 4


class Editor:
    """The page of one descriptor, served behind a gate until `close`; all browsers that open it see the same."""

    def __init__(self, robot: RobotDescription, gate: Gate) -> None:
        self._robot = robot
        self.server = gate.serve("zarm")
        self.address = gate.address(self.server.get_port())
        add_environment(self.server, robots=1)
        self._arm = Arm(self.server.scene, "/robot", robot, body_of(robot), LINKS, opacity=0.6)
        gui = self.server.gui
        gui.add_markdown(f"**{robot.path.name}**")
        save = gui.add_button("Save", icon=Icon.DEVICE_FLOPPY, hint="Write it into the file and look for what is wrong")
        save.on_click(self._save)
        self._said = gui.add_markdown("")
        tabs = gui.add_tab_group()
        with tabs.add_tab("Spheres"):
            self._spheres = _Spheres(self.server, self._arm, robot)
        with tabs.add_tab("Pairs"):
            self._pairs = _Pairs(self.server, robot)
        with tabs.add_tab("Home"):
            self._home = _Home(self.server, self._arm, robot)

    def close(self) -> None:
        """Close every open page, and end."""
        self.server.stop()

    def _save(self, event: GuiEvent[viser.GuiButtonHandle]) -> None:
        wanted = Corrections(self._home.value, self._spheres.of_links, self._pairs.ignored)
        try:
            self._robot = wanted.write(self._robot)
            log.info("saved file=%s", self._robot.path)
            self._said.content = "Saved. Looking for what is wrong ..."
            self._said.content = "  \n".join(["Saved.", *_findings(self._robot)])
        except (ZarmError, OSError) as error:
            self._said.content = f"Not saved: {error}"


class _Spheres:
    """The sphere cover: one sphere is chosen by its link and number, dragged by its gizmo, resized, added or removed."""

    def __init__(self, server: viser.ViserServer, arm: Arm, robot: RobotDescription) -> None:
        self._server, self._arm = server, arm
        self.of_links = dict(robot.descriptor.spheres)
        self._brush = Brush(server.scene, SPHERES, 0.35)
        self._drawn: dict[str, MeshHandle] = {}
        self._marked: MeshHandle | None = None
        self._gizmo: TransformControlsHandle | None = None
        gui = server.gui
        self._link = gui.add_dropdown("link", list(self.of_links))
        self._number = gui.add_slider("sphere", min=1, max=2, step=1, initial_value=1)
        self._center = gui.add_vector3("center (m)", (0.0, 0.0, 0.0), step=STEP, hint="In the frame of the link")
        self._radius = gui.add_number("radius (m)", 0.1, min=SMALLEST, step=STEP)
        add = gui.add_button("Add one like it", icon=Icon.PLUS)
        remove = gui.add_button("Remove it", icon=Icon.TRASH)
        self._link.on_update(_by_person(lambda: self._choose(0)))
        self._number.on_update(_by_person(lambda: self._choose(self._number.value - 1)))
        for handle in (self._center, self._radius):
            handle.on_update(_by_person(self._entered))
        add.on_click(lambda _: self._add())
        remove.on_click(lambda _: self._remove())
        for link in self.of_links:
            self._draw(link)
        self._choose(0)

    def _mine(self) -> tuple[CollisionSphere, ...]:
        return self.of_links[self._link.value]

    def _choose(self, index: int) -> None:
        """Show the numbers of a sphere of the chosen link, and move the gizmo to it."""
        mine, link = self._mine(), self._link.value
        self._number.max = max(len(mine), 2)  # a slider needs two distinct ends
        index = min(index, len(mine) - 1)
        put(self._number, index + 1)
        put(self._center, mine[index].center)
        put(self._radius, mine[index].radius)
        if self._gizmo is not None:
            self._gizmo.remove()
        node = self._arm.nodes[link]
        self._gizmo = self._server.scene.add_transform_controls(
            f"{node}/chosen", scale=0.12, disable_rotations=True, depth_test=False, position=mine[index].center
        )
        self._gizmo.on_update(self._drag)
        self._mark(mine[index])

    def _mark(self, sphere: CollisionSphere) -> None:
        if self._marked is not None:
            self._marked.remove()
        brush = Brush(self._server.scene, CHOSEN, 0.5)
        self._marked = brush.mesh(f"{self._arm.nodes[self._link.value]}/marked", link_mesh([sphere]), SE3.identity())

    def _drag(self, event: TransformControlsEvent) -> None:
        x, y, z = event.target.position
        put(self._center, (float(x), float(y), float(z)))
        if event.phase == "end":
            self._put(self._entered_sphere())

    def _entered(self) -> None:
        self._put(self._entered_sphere())
        if self._gizmo is not None:
            self._gizmo.position = self._center.value

    def _entered_sphere(self) -> CollisionSphere:
        x, y, z = (round(value, DIGITS) for value in self._center.value)
        return CollisionSphere(center=(x, y, z), radius=max(round(self._radius.value, DIGITS), SMALLEST))

    def _put(self, sphere: CollisionSphere) -> None:
        """Replace the chosen sphere."""
        at = self._number.value - 1
        self._change((*self._mine()[:at], sphere, *self._mine()[at + 1 :]))
        self._mark(sphere)

    def _add(self) -> None:
        self._change((*self._mine(), self._entered_sphere()))
        self._choose(len(self._mine()) - 1)

    def _remove(self) -> None:
        at = self._number.value - 1
        if len(self._mine()) > 1:  # a link without spheres is not checked for collisions in the search
            self._change((*self._mine()[:at], *self._mine()[at + 1 :]))
            self._choose(at)

    def _change(self, spheres: tuple[CollisionSphere, ...]) -> None:
        self.of_links[self._link.value] = spheres
        self._draw(self._link.value)

    def _draw(self, link: str) -> None:
        if link in self._drawn:
            self._drawn[link].remove()
        self._drawn[link] = self._brush.mesh(
            f"{self._arm.nodes[link]}/spheres", link_mesh(self.of_links[link]), SE3.identity()
        )


class _Pairs:
    """A check box for every pair of links; if it is ticked, the two are checked against each other."""

    def __init__(self, server: viser.ViserServer, robot: RobotDescription) -> None:
        self._before = robot.descriptor.self_collision_ignore
        ignored = {frozenset(pair) for pair in self._before}
        self._boxes: dict[tuple[str, str], viser.GuiCheckboxHandle] = {}
        server.gui.add_markdown("Links that are checked against each other:")
        for first, second in combinations(robot.descriptor.collision, 2):
            self._boxes[first, second] = server.gui.add_checkbox(
                f"{first}, {second}", frozenset((first, second)) not in ignored
            )

    @property
    def ignored(self) -> tuple[tuple[str, str], ...]:
        """The pairs that are not checked, previous ones in their order."""
        chosen = {frozenset(pair) for pair, box in self._boxes.items() if not box.value}
        shown = {frozenset(pair) for pair in self._boxes}
        kept = [pair for pair in self._before if frozenset(pair) in chosen or frozenset(pair) not in shown]
        known = {frozenset(pair) for pair in kept}
        return (*kept, *(pair for pair in self._boxes if frozenset(pair) in chosen - known))


class _Home:
    """A slider for each joint, which moves the drawing; their positions are saved as the home."""

    def __init__(self, server: viser.ViserServer, arm: Arm, robot: RobotDescription) -> None:
        descriptor = robot.descriptor
        self._before = descriptor.home
        self._sliders = []
        server.gui.add_markdown("The joints at home (rad, m):")
        limits = robot.range_about(descriptor.home)
        for joint, low, high, at in zip(descriptor.joints, *limits, descriptor.home, strict=True):
            slider = server.gui.add_slider(joint, min=low, max=high, step=STEP, initial_value=at)
            slider.on_update(lambda _: self._show(arm))
            self._sliders.append(slider)

    def _show(self, arm: Arm) -> None:
        arm.move(np.array(self.value))

    @property
    def value(self) -> tuple[float, ...]:
        """Joint positions (J,) in rad, m if prismatic; unmoved ones keep their value."""
        shown = [round(slider.value, DIGITS) for slider in self._sliders]
        return tuple(was if abs(now - was) < STEP else now for now, was in zip(shown, self._before, strict=True))


def _by_person(work: Callable[[], object]) -> Callable[[GuiEvent[Any]], None]:
    """A handler of changes by a user, but not by the page."""

    def update(event: GuiEvent[Any]) -> None:
        if event.client is not None:
            work()

    return update


def _findings(robot: RobotDescription) -> list[str]:
    """The findings of `zarm robot check`."""
    try:
        from zarm_robot_import.checking import findings
    except ImportError as error:
        return [f"What is wrong with it was not looked for, because {error.name} cannot be imported here."]
    return findings(robot) or ["Nothing is wrong with it, as far as can be told."]


def main() -> int:
    """Serve the page until SIGTERM or SIGINT; the exit code."""
    signals.expect()
    parser = argparse.ArgumentParser("zarm robot edit", description="Correct a robot descriptor in the browser.")
    parser.add_argument("descriptor", help="its file (.yaml)")
    parser.add_argument("--listen", required=True, metavar="HOST:PORT", help="where the page is served")
    options = parser.parse_args()
    setup_logging("editor")
    try:
        editor = Editor(load_robot(options.descriptor), Gate.at(options.listen))
    except ZarmError as error:
        log.error("cannot run reason=%s", error)
        return 1
    print(editor.address, flush=True)  # noqa: T201 - what is opened in the browser
    while not signals.received:
        signals.wait()
    editor.close()
    return 0


if __name__ == "__main__":
    sys.exit(main())
