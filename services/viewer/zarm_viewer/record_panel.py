"""The panel of a record: play it, go to any moment, and read what happened."""

from __future__ import annotations

from datetime import UTC, datetime
from html import escape

from viser import Icon

from zarm_viewer.controls import changed, put
from zarm_viewer.panel_context import PanelContext
from zarm_viewer.playback import SPEEDS, Playback

STEP = 0.05
"""Resolution (s) of the slider."""


class RecordPanel:
    """Play, pause, the moment, the speed, and the story of the record."""

    def __init__(self, panels: PanelContext, playback: Playback) -> None:
        self._playback = playback
        story, gui = playback.story, panels.server.gui
        began = f"{datetime.fromtimestamp(story.began / 1e9, UTC):%Y-%m-%d %H:%M:%S} UTC"
        gui.add_markdown(f"`{playback.file.name}`  \nbegan {began}, lasted {story.lasted:.1f} s")
        self._play = gui.add_button("Pause", icon=Icon.PLAYER_PLAY)
        self._play.on_click(lambda _: playback.pause() if playback.playing else playback.play())
        self._moment = gui.add_slider("time (s)", 0.0, max(STEP, round(story.lasted, 2)), STEP, 0.0)
        changed(panels, self._moment, "look at the record", lambda: playback.seek(self._moment.value))
        speed = gui.add_dropdown("speed", [f"{each:g}" for each in SPEEDS], initial_value="1")

        def choose() -> None:
            playback.seek(playback.at)
            playback.speed = float(speed.value)

        changed(panels, speed, "speed", choose)
        if (far := story.deviation) is not None:
            gui.add_markdown(f"furthest off: {far.joint} by {1e3 * far.size:.1f} mrad at {far.time:.2f} s")
        self._reported = gui.add_markdown("")
        self._lines = [
            (each.time, f"`{each.time:7.2f} s` {escape(each.subject)}: {escape(each.what)}") for each in story.events
        ]
        self._shown = -1

    def draw(self) -> None:
        """Show the current moment, and what has happened so far, newest first."""
        at = self._playback.at
        put(self._play, "Pause" if self._playback.playing else "Play", "label")
        put(self._moment, round(min(at, self._moment.max) / STEP) * STEP)
        past = [line for time, line in self._lines if time <= at]
        if len(past) != self._shown:
            self._shown = len(past)
            self._reported.content = "  \n".join(reversed(past))
