"""The robot's status in words, and the event log."""

from __future__ import annotations

import time
from pathlib import Path

from viser import ClientHandle, GuiButtonHandle, GuiEvent, Icon

from zarm.servoing import limited
from zarm_contract.errors import MEANINGS, InvalidRequest
from zarm_contract.messages import ExecutorState, GoalState, Plan, ServoState
from zarm_viewer.controls import put
from zarm_viewer.desk import Desk
from zarm_viewer.watching import News

SILENT = 1.0
"""Joint states older than this (s) are shown as stale."""
LOOK = 1.0
"""Interval (s) at which records of faults are looked for."""


class StatusPanel:
    """Mode, strategy, goal, progress, what limits the robot, the last plan's figures, faults."""

    def __init__(self, desk: Desk) -> None:
        self._desk = desk
        self._text = desk.server.gui.add_markdown("*waiting for the robot*")
        self._progress = desk.server.gui.add_progress_bar(0.0, visible=False)
        self._state: ExecutorState | None = None
        self._goal: GoalState | None = None
        self._plan: Plan | None = None
        self._servo: ServoState | None = None

    def draw(self, news: News, age: float | None) -> None:
        """Show what has changed; `age` (s) is that of the newest joint state."""
        if news.state is not None:
            if news.state.problem is not None and (self._state is None or news.state.problem != self._state.problem):
                self._desk.note(f"**fault** {news.state.problem.message}")
            self._state = news.state
        for goal in news.goals:
            if self._goal is None or (goal.goal_id, goal.status) != (self._goal.goal_id, self._goal.status):
                why = f": {goal.problem.message}" if goal.problem else ""
                self._desk.note(f"{goal.goal_id} {goal.status}{why}")
            self._goal = goal
        self._plan = news.plan or self._plan
        self._servo = news.servo or self._servo
        text = "  \n".join(self._lines(age))
        if self._text.content != text:
            self._text.content = text
        self._draw_progress()

    def _lines(self, age: float | None) -> list[str]:
        state, goal, plan, servo = self._state, self._goal, self._plan, self._servo
        if state is None:
            return ["*no executor answers; `zarm status` shows what runs*"]
        lines = [f"**{state.mode}** · {state.strategy} · speed {state.speed_scale:.0%}"]
        if age is None or age > SILENT:
            lines.append("**no joint states**")
        if state.problem is not None:
            lines.append(f"**{state.problem.code}**: {state.problem.message}")
            lines.append(MEANINGS[state.problem.code].remedy)
        if goal is not None:
            lines.append(f"{goal.status} · {goal.progress:.0%} of {goal.duration:.2f} s")
            if goal.hold is not None:
                what = goal.hold.obstruction
                lines.append(
                    f"held: {goal.hold.reason}" + (f", {what.object} in the way of {what.link}" if what else "")
                )
        if state.mode == "running" and not state.guarded:
            lines.append("unguarded" + (", and the scene has changed" if state.scene_changed else ""))
        if servo is not None and servo.session is not None:
            lines.append(f"jog: {limited(servo.session)}")
        if plan is not None:
            stages = plan.timings
            lines.append(
                f"plan {plan.trajectory.duration:.2f} s · clearance {plan.clearance * 1e3:.0f} mm · planned in "
                f"{stages.total * 1e3:.0f} ms"
            )
            lines.append(
                f"ik {stages.ik * 1e3:.1f} · search {stages.search * 1e3:.1f} · shortcut {stages.shortcut * 1e3:.1f} · timing "
                f"{stages.timing * 1e3:.1f} · verify {stages.verify * 1e3:.1f} · optimise {stages.optimize * 1e3:.1f} ms"
            )
        return lines

    def _draw_progress(self) -> None:
        goal = self._goal
        running = goal is not None and not goal.done
        if self._progress.visible != running:
            self._progress.visible = running
        if goal is not None and running and abs(self._progress.value - 100 * goal.progress) >= 1.0:
            put(self._progress, 100 * goal.progress)


class EventsPanel:
    """The event log, newest first, and the fault records in the folder `records`, if the executor is on this machine."""

    def __init__(self, desk: Desk, records: Path) -> None:
        self._desk, self._records = desk, records
        gui = desk.server.gui
        self._choice = gui.add_dropdown("record", ["-"], visible=False)
        self._download = gui.add_button(
            "Download", icon=Icon.DOWNLOAD, visible=False, hint="`zarm replay --view FILE` plays it on a page"
        )

        @self._download.on_click
        def _(event: GuiEvent[GuiButtonHandle]) -> None:
            desk.attempt("download", lambda: self._send(event.client), event.client)

        self._text = gui.add_markdown("")
        self._shown = ""
        self._look = 0.0
        desk.note(f"page opened on {desk.name}, {time.strftime('%Y-%m-%d')}")

    def draw(self) -> None:
        """Show new events and records."""
        text = "  \n".join(list(self._desk.events))
        if text != self._shown:
            self._text.content = self._shown = text
        if (now := time.monotonic()) > self._look:
            self._look = now + LOOK
            names = tuple(sorted((file.name for file in self._records.glob("*.mcap")), reverse=True))
            if names and names != self._choice.options:
                self._choice.options = names
                put(self._choice, names[0])
            put(self._choice, bool(names), "visible")
            put(self._download, bool(names), "visible")

    def _send(self, client: ClientHandle | None) -> None:
        file = self._records / self._choice.value
        try:
            content = file.read_bytes()
        except OSError as error:
            raise InvalidRequest(
                f"{file.name} cannot be read any more: {error.strerror}; choose a newer one"
            ) from error
        if client is not None:
            client.send_file_download(file.name, content)
