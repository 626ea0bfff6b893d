"""The robot's status in words, and the event log."""

from __future__ import annotations

import time
from collections.abc import Sequence
from html import escape
from pathlib import Path

from viser import ClientHandle, GuiButtonHandle, GuiEvent, Icon

from zarm.servoing import limited
from zarm_contract.errors import MEANINGS, InvalidRequest
from zarm_contract.messages import ExecutorState, GoalState, Plan, ServoState
from zarm_viewer.controls import put
from zarm_viewer.panel_context import PanelContext
from zarm_viewer.watching import News

LINES = 5
"""The least height of the status in lines of text. If it grew and shrank, buttons below it would move between two clicks."""
SILENT = 1.0
"""Joint states older than this (s) are shown as stale."""
REFRESH_PERIOD = 1.0
"""Interval (s) at which records of faults are looked for."""


class StatusPanel:
    """Mode, strategy, goal, progress, what limits the robot, the last plan's figures, faults."""

    def __init__(self, panels: PanelContext) -> None:
        self._panels = panels
        self._text = panels.server.gui.add_html(_html(["<i>waiting for the robot</i>"]))
        self._progress = panels.server.gui.add_progress_bar(0.0)
        self._state: ExecutorState | None = None
        self._goal: GoalState | None = None
        self._plan: Plan | None = None
        self._servo: ServoState | None = None

    def draw(self, news: News, age: float | None) -> None:
        """Show what has changed; `age` (s) is that of the newest joint state."""
        if news.state is not None:
            if news.state.problem is not None and (self._state is None or news.state.problem != self._state.problem):
                self._panels.note(f"**fault** {news.state.problem.message}")
            self._state = news.state
        for goal in news.goals:
            if self._goal is None or (goal.goal_id, goal.status) != (self._goal.goal_id, self._goal.status):
                why = f": {goal.problem.message}" if goal.problem else ""
                self._panels.note(f"{goal.goal_id} {goal.status}{why}")
            self._goal = goal
        self._plan = news.plan or self._plan
        self._servo = news.servo or self._servo
        put(self._text, _html(self._lines(age)), "content")
        progress = 100 * self._goal.progress if self._goal is not None and not self._goal.done else 0.0
        if abs(self._progress.value - progress) >= 1.0:
            put(self._progress, progress)

    def forget_plan(self) -> None:
        """Leave out the figures of a plan that no longer holds."""
        self._plan = None

    def _lines(self, age: float | None) -> list[str]:
        """The status in lines of HTML."""
        state = self._state
        if state is None:
            return ["<i>no executor answers; <code>zarm status</code> shows what runs</i>"]
        lines = [f"<b>{state.mode}</b> · {state.strategy} · speed {state.speed_scale:.0%}"]
        if age is None or age > SILENT:
            lines.append("<b>no joint states</b>")
        if state.problem is not None:
            lines.append(f"<b>{state.problem.code}</b>: {escape(state.problem.message)}")
            lines.append(escape(MEANINGS[state.problem.code].remedy))
        if self._goal is not None:
            lines.append(_goal(self._goal, state))
        session = None if self._servo is None else self._servo.session
        if session is not None:
            near = "" if session.clearance is None else f" · clearance {session.clearance * 1e3:.0f} mm"
            lines.append(f"jog: <b>{escape(limited(session))}</b>{near}")
        elif self._plan is not None:
            lines += _plan(self._plan)
        return lines


def _html(lines: Sequence[str]) -> str:
    style = f"line-height: 1.45; font-size: 0.875em; padding: 0 0.75em; min-height: {1.45 * LINES}em"
    return f'<div style="{style}">{"<br>".join(lines)}</div>'


def _goal(goal: GoalState, state: ExecutorState) -> str:
    """How far a goal is, and what holds it."""
    line = f"{goal.status} · {goal.progress:.0%} of {goal.duration:.2f} s"
    if goal.hold is not None:
        what = goal.hold.obstruction
        line += f" · held: {goal.hold.reason}" + (f", {what.object} in the way of {what.link}" if what else "")
    if state.mode == "running" and not state.guarded:
        line += " · unguarded" + (", and the scene has changed" if state.scene_changed else "")
    return escape(line)


def _plan(plan: Plan) -> list[str]:
    """A plan's figures: duration, clearance, and the time (ms) that each stage of planning took."""
    stages = plan.timings
    return [
        f"plan {plan.trajectory.duration:.2f} s · clearance {plan.clearance * 1e3:.0f} mm · planned in {stages.total * 1e3:.0f} ms",
        f"ik {stages.ik * 1e3:.1f} · search {stages.search * 1e3:.1f} · shortcut {stages.shortcut * 1e3:.1f} · timing "
        f"{stages.timing * 1e3:.1f} · verify {stages.verify * 1e3:.1f} · optimise {stages.optimize * 1e3:.1f} ms",
    ]


class EventsPanel:
    """The event log, newest first, and the fault records in the folder `records`, if the executor is on this machine."""

    def __init__(self, panels: PanelContext, records: Path) -> None:
        self._panels, self._records = panels, records
        gui = panels.server.gui
        self._choice = gui.add_dropdown("record", ["-"], visible=False)
        self._download = gui.add_button(
            "Download", icon=Icon.DOWNLOAD, visible=False, hint="`zarm replay --view FILE` plays it on a page"
        )

        @self._download.on_click
        def _(event: GuiEvent[GuiButtonHandle]) -> None:
            panels.attempt("download", lambda: self._send(event.client), event.client)

        self._text = gui.add_markdown("")
        self._shown = ""
        self._refreshed_at = 0.0
        panels.note(f"page opened on {panels.name}, {time.strftime('%Y-%m-%d')}")

    def draw(self) -> None:
        """Show new events and records."""
        text = "  \n".join(list(self._panels.events))
        if text != self._shown:
            self._text.content = self._shown = text
        if (now := time.monotonic()) > self._refreshed_at:
            self._refreshed_at = now + REFRESH_PERIOD
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
            client.send_file_download(file.name, content, save_immediately=True)
