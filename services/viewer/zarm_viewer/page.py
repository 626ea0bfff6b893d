"""The page: one viser server that shows every robot, with its panels."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import viser
from viser import GuiButtonHandle, GuiEvent, GuiTabGroupHandle, Icon

from zarm.robot import Robot
from zarm_contract.access import Role
from zarm_contract.errors import ZarmError
from zarm_contract.robot import RobotDescription
from zarm_viewer.aim import Goal
from zarm_viewer.desk import Desk
from zarm_viewer.gate import Gate
from zarm_viewer.jog_panel import JogPanel
from zarm_viewer.motion_panel import MotionPanel
from zarm_viewer.named_poses import NamedPoses
from zarm_viewer.objects_panel import ObjectsPanel
from zarm_viewer.picture import Picture
from zarm_viewer.plots_panel import PlotsPanel
from zarm_viewer.status_panel import EventsPanel, StatusPanel
from zarm_viewer.stop import Stop
from zarm_viewer.watching import News, Watching

log = logging.getLogger(__name__)

PERIOD = 1 / 30
"""s between two drawings, where anything changes."""
BESIDE = 2.5
"""Robots stand so many m apart in the picture, along y: the bus does not say where their bases are."""


@dataclass(frozen=True)
class Shown:
    """A robot on the bus, and what it looks like."""

    robot: Robot
    description: RobotDescription


class Page:
    """The page of these robots, served behind a gate until `close`."""

    def __init__(self, robots: Sequence[Shown], gate: Gate, role: Role, meshes: tuple[Path, ...], state: Path) -> None:
        self.server = gate.serve("zarm")
        self.address = gate.address(self.server.get_port())
        self._furnish()
        moves = role != "viewer"
        self._stops: list[Stop] = []
        self._add_stop()
        self._parts = [_Part(self.server, shown, moves, meshes, state, BESIDE * at) for at, shown in enumerate(robots)]
        self._choose_between(self._parts)
        for shown, part in zip(robots, self._parts, strict=True):
            endpoint = shown.robot.connection.bus.endpoint
            self._stops.append(Stop(endpoint, shown.robot.name, role, part.stopped))
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._draw, name="page", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Close every page that is open, and end."""
        self._ended.set()
        self._thread.join()
        for stop in self._stops:
            stop.close()
        self.server.stop()

    def _furnish(self) -> None:
        scene, gui = self.server.scene, self.server.gui
        scene.set_up_direction("+z")
        scene.configure_environment_map(
            hdri=None
        )  # reflections would cost a machine without a GPU a second for each frame
        scene.configure_default_lights(cast_shadow=False)
        scene.add_light_ambient("/light", intensity=1.2)
        scene.add_grid("/floor", width=4.0, height=4.0, cell_size=0.5, section_size=1.0, plane="xy")
        self.server.initial_camera.position = (1.65, -1.0, 1.2)
        self.server.initial_camera.look_at = (0.35, 0.15, 0.45)
        gui.configure_theme(show_logo=False, show_share_button=False, control_width="medium")

    def _add_stop(self) -> None:
        button = self.server.gui.add_button("STOP", color="red", icon=Icon.HAND_STOP, hint="Brake to rest now (Escape)")
        escape = self.server.gui.add_command("Stop", hotkey="escape", description="Brake every robot to rest now")

        @button.on_click
        async def _(_: object) -> None:  # in the server's own loop: no thread of a pool is waited for
            self.stop()

        @escape.on_trigger
        async def _(_: object) -> None:
            self.stop()

    def stop(self) -> None:
        """Stop every robot on the page, now."""
        for stop in self._stops:
            stop.press()

    def _choose_between(self, parts: Sequence[_Part]) -> None:
        if len(parts) < 2:
            return
        names = [part.desk.robot.name for part in parts]
        choice = self.server.gui.add_dropdown("robot", names, order=-1)

        def choose() -> None:
            for part in parts:
                part.chosen(part.desk.robot.name == choice.value)

        choice.on_update(lambda _: choose())
        choose()

    def _draw(self) -> None:
        while not self._ended.wait(PERIOD):
            try:
                with self.server.atomic():
                    for part in self._parts:
                        part.draw()
            except Exception:
                log.exception("drawing failed")


class _Part:
    """One robot's share of the page."""

    def __init__(
        self, server: viser.ViserServer, shown: Shown, moves: bool, meshes: tuple[Path, ...], state: Path, aside: float
    ) -> None:
        name = shown.robot.name
        self.desk = Desk(server, shown.robot, shown.description, f"/{name}", moves)
        server.scene.add_frame(self.desk.root, show_axes=False, position=(0.0, aside, 0.0))
        self._picture = Picture(self.desk, meshes)
        self._folder = server.gui.add_folder(name)
        with self._folder:
            self._status = StatusPanel(self.desk)
            if moves:
                self._add_reset(shown.robot)
            tabs = server.gui.add_tab_group()
            self._controls = _Controls(self.desk, self._picture, tabs, state) if moves else None
            with tabs.add_tab("Plots"):
                self._plots = PlotsPanel(self.desk)
            with tabs.add_tab("Events"):
                self._events = EventsPanel(self.desk)
        self._watching = Watching(shown.robot, shown.description.descriptor.joints)

    def chosen(self, yes: bool) -> None:
        """Show its panels, or those of another robot."""
        self._folder.visible = yes
        if self._controls is not None:
            self._controls.chosen(yes)

    def stopped(self, name: str, error: ZarmError | None) -> None:
        """Say what came of a stop."""
        if error is None:
            self.desk.note("**stop**")
        else:
            self.desk.tell(f"{name} was not told to stop", str(error), colour="red")

    def draw(self) -> None:
        """Show what is new."""
        news = self._watching.take()
        self._picture.draw(news)
        self._status.draw(news, self._watching.age(time.monotonic()))
        if news.state is not None and self._controls is not None:
            self._reset.visible = news.state.mode == "fault"
        self._plots.draw(news)
        if self._controls is not None:
            self._controls.draw(news)
        self._events.draw()

    def _add_reset(self, robot: Robot) -> None:
        self._reset = self.desk.server.gui.add_button("Reset the fault", color="orange", visible=False)

        @self._reset.on_click
        def _(event: GuiEvent[GuiButtonHandle]) -> None:
            self.desk.attempt("reset", robot.reset, event.client)


class _Controls:
    """What moves a robot; a page of a viewer has none of it."""

    def __init__(self, desk: Desk, picture: Picture, tabs: GuiTabGroupHandle, state: Path) -> None:
        self._goal = Goal(desk)
        poses = NamedPoses(state, desk.robot.name, desk.description.descriptor.home)
        with tabs.add_tab("Move"):
            self._motion = MotionPanel(desk, self._goal, poses)
        with tabs.add_tab("Scene"):
            self._objects = ObjectsPanel(desk, picture.scene)
        with tabs.add_tab("Jog"):
            self._jog = JogPanel(desk, self._goal)

    def chosen(self, yes: bool) -> None:
        """Show the gizmo, or not."""
        self._goal.show(gizmo=yes)

    def draw(self, news: News) -> None:
        """Show what is new."""
        self._motion.draw(news)
        self._objects.draw(news.scene)
        self._jog.draw(news.servo)
