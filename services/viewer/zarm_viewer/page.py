"""The page: one viser server that shows every robot, with its panels."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import viser
from viser import GuiButtonHandle, GuiEvent, GuiTabGroupHandle, Icon

from zarm.robot import Robot
from zarm_contract.errors import ZarmError
from zarm_contract.robot import RobotDescription
from zarm_contract.roles import Role
from zarm_runtime.worker import Worker
from zarm_viewer.agent_panel import AgentPanel
from zarm_viewer.aim import Goal
from zarm_viewer.environment import BESIDE, add_environment
from zarm_viewer.gate import Gate
from zarm_viewer.gripper_panel import GripperPanel
from zarm_viewer.jog_panel import JogPanel
from zarm_viewer.looks_panel import LooksPanel
from zarm_viewer.motion_panel import MotionPanel
from zarm_viewer.named_poses import NamedPoses
from zarm_viewer.objects_panel import ObjectsPanel
from zarm_viewer.panel_context import PanelContext
from zarm_viewer.picture import Picture
from zarm_viewer.playback import Playback
from zarm_viewer.plots_panel import PlotsPanel
from zarm_viewer.record_panel import RecordPanel
from zarm_viewer.status_panel import EventsPanel, StatusPanel
from zarm_viewer.stop import Stop
from zarm_viewer.style import STOP
from zarm_viewer.watching import News, Watching

log = logging.getLogger(__name__)

PERIOD = 1 / 30
"""Interval (s) between two drawings while anything changes."""
MIN_PAUSE = PERIOD / 4
"""The least pause (s) between two drawings, in which other threads get the interpreter."""
UNSEEN = 0.5
"""The same (s) while no page is open."""


@dataclass(frozen=True)
class Shown:
    """A robot on the bus or in a record, and its look."""

    source: Robot | Playback
    description: RobotDescription

    @property
    def name(self) -> str:
        """Its name."""
        return self.source.story.robot if isinstance(self.source, Playback) else self.source.name


@dataclass(frozen=True)
class Folders:
    """Folders of files: meshes of the scene, the viewer's state, and the executor's records of faults."""

    meshes: tuple[Path, ...]
    state: Path
    records: Path


class Page:
    """The page of these robots, served behind a gate until `close`."""

    def __init__(self, robots: Sequence[Shown], gate: Gate, role: Role, folders: Folders) -> None:
        self.server = gate.serve("zarm")
        self.address = gate.address(self.server.get_port())
        add_environment(self.server, len(robots))
        moves = role != "viewer"
        self._stops: list[Stop] = []
        if any(isinstance(shown.source, Robot) for shown in robots):
            self._add_stop()
        self._parts = [_Part(self.server, shown, moves, folders, BESIDE * at) for at, shown in enumerate(robots)]
        self._choose_between(self._parts)
        for shown, part in zip(robots, self._parts, strict=True):
            if isinstance(shown.source, Robot):
                endpoint = shown.source.connection.bus.endpoint
                self._stops.append(Stop(endpoint, shown.name, role, part.stopped))
        self._due = time.monotonic()
        self._worker = Worker("page", self._draw)
        self._worker.wake()
        self._worker.start()

    def close(self) -> None:
        """Close every open page, and end."""
        self._worker.stop()
        for stop in self._stops:
            stop.close()
        self.server.stop()

    def _add_stop(self) -> None:
        gui = self.server.gui
        beside = gui.add_panel()  # a panel of its own, which does not scroll with the long ones
        with beside.add_tab("Stop"):
            always = gui.add_button("STOP", color=STOP, icon=Icon.HAND_STOP, hint="Brake to rest now (Escape)")
        beside.float(x=15, y=-15, width=220)
        beside.expand()  # on a phone it is the last part of the scrolling panel, and would be collapsed
        first = gui.add_button("STOP", color=STOP, icon=Icon.HAND_STOP, hint="Brake to rest now (Escape)")
        escape = self.server.gui.add_command("Stop", hotkey="escape", description="Brake every robot to rest now")

        async def stop(_: object) -> None:  # in the server's own loop, so that it waits for no thread of a pool
            self.stop()

        always.on_click(stop)
        first.on_click(stop)
        escape.on_trigger(stop)

    def stop(self) -> None:
        """Stop every robot on the page, now."""
        for stop in self._stops:
            stop.press()

    def _choose_between(self, parts: Sequence[_Part]) -> None:
        if len(parts) < 2:
            return
        names = [part.panels.name for part in parts]
        choice = self.server.gui.add_dropdown("robot", names, order=-1)

        def choose() -> None:
            for part in parts:
                part.chosen(part.panels.name == choice.value)

        choice.on_update(lambda _: choose())
        choose()

    def _draw(self) -> float:
        """Draw what has changed; the time (s) until it is drawn again."""
        try:
            with self.server.atomic():
                for part in self._parts:
                    part.draw()
            self.server.flush()
        except Exception:
            log.exception("drawing failed")
        self._due = max(self._due + (PERIOD if self.server.get_clients() else UNSEEN), time.monotonic() + MIN_PAUSE)
        return self._due - time.monotonic()


class _Part:
    """One robot's share of the page."""

    def __init__(self, server: viser.ViserServer, shown: Shown, moves: bool, folders: Folders, aside: float) -> None:
        client = shown.source if isinstance(shown.source, Robot) else None
        moves = moves and client is not None
        self.panels = PanelContext(server, shown.name, shown.description, client, moves, aside)
        server.scene.add_frame(self.panels.root, show_axes=False, position=(0.0, aside, 0.0))
        self._picture = Picture(self.panels, folders.meshes)
        self._folder = server.gui.add_folder(shown.name)
        self._record: RecordPanel | None = None
        self._events: EventsPanel | None = None
        self._controls: _Controls | None = None
        with self._folder:
            self._status = StatusPanel(self.panels)
            if moves:
                self._add_reset()
                self._agent = AgentPanel(self.panels)
            tabs = server.gui.add_tab_group()
            if moves:
                self._controls = _Controls(self.panels, self._picture, tabs, folders.state, self._forget_plan)
            if isinstance(shown.source, Playback):
                with tabs.add_tab("Record"):
                    self._record = RecordPanel(self.panels, shown.source)
            with tabs.add_tab("Look"):
                self._looks = LooksPanel(self.panels, self._picture)
            with tabs.add_tab("Plots"):
                self._plots = PlotsPanel(self.panels)
            if client is not None:
                with tabs.add_tab("Log"):
                    self._events = EventsPanel(self.panels, folders.records / shown.name / "records")
        self._source = Watching(shown.source, server.get_clients) if isinstance(shown.source, Robot) else shown.source

    def chosen(self, yes: bool) -> None:
        """Show its panels, or those of another robot."""
        self._folder.visible = yes
        if self._controls is not None:
            self._controls.chosen(yes)

    def stopped(self, name: str, error: ZarmError | None) -> None:
        """Report the result of a stop."""
        if error is None:
            self.panels.note("**stop**")
        else:
            self.panels.notify(f"{name} was not told to stop", str(error), colour="red")

    def draw(self) -> None:
        """Show what has changed."""
        news = self._source.take(self.panels.description.descriptor.joints)
        self._picture.draw(news)
        self._status.draw(news, self._source.age())
        if news.state is not None and self._controls is not None:
            self._reset.visible = news.state.mode == "fault"
        self._looks.draw()
        self._plots.draw(news)
        if self._controls is not None:
            self._controls.draw(news)
            self._agent.draw()
        if self._record is not None:
            self._record.draw()
        if self._events is not None:
            self._events.draw()

    def _forget_plan(self) -> None:
        self._picture.forget_path()
        self._status.forget_plan()

    def _add_reset(self) -> None:
        self._reset = self.panels.server.gui.add_button("Reset the fault", color="orange", visible=False)

        @self._reset.on_click
        def _(event: GuiEvent[GuiButtonHandle]) -> None:
            self.panels.attempt("reset", self.panels.robot.reset, event.client)


class _Controls:
    """Controls that move a robot; the page of a viewer role has none."""

    def __init__(
        self,
        panels: PanelContext,
        picture: Picture,
        tabs: GuiTabGroupHandle,
        state: Path,
        forget_plan: Callable[[], object],
    ) -> None:
        self._goal = Goal(panels)
        poses = NamedPoses(state / "viewer", panels.robot.name, panels.description.descriptor.home)
        with tabs.add_tab("Move"):
            self._motion = MotionPanel(panels, self._goal, poses, forget_plan)
        with tabs.add_tab("Scene"):
            self._objects = ObjectsPanel(panels, picture.scene)
        with tabs.add_tab("Jog"):
            self._jog = JogPanel(panels, self._goal)
        self._grippers: GripperPanel | None = None
        if panels.description.descriptor.grippers:
            with tabs.add_tab("Gripper"):
                self._grippers = GripperPanel(panels)

    def chosen(self, yes: bool) -> None:
        """Show or hide the handles, and take keys or leave them."""
        self._motion.chosen(yes)
        self._jog.chosen(yes)

    def draw(self, news: News) -> None:
        """Show what has changed."""
        self._motion.draw(news)
        self._objects.draw(news.scene)
        if self._grippers is not None:
            self._grippers.draw(news.grippers)
