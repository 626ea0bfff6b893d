"""What an agent wants to do, and a person approves or not."""

from __future__ import annotations

import time
from functools import cached_property

from viser import Icon

from zarm_contract.messages import AgentAnswer, AgentQuestion
from zarm_runtime.bus import Publisher
from zarm_viewer.controls import button, put
from zarm_viewer.panel_context import PanelContext

_GONE = 1.5
"""A question that has not been repeated for so long (s) was answered elsewhere, or given up."""


class AgentPanel:
    """Shown while there is a question."""

    def __init__(self, panels: PanelContext) -> None:
        self._asked: tuple[AgentQuestion, float] | None = None
        self._answered = ""
        self._connection = panels.robot.connection
        self._connection.bus.subscribe(self._connection.keys.agent_question, self._on_question)
        self._folder = panels.server.gui.add_folder("An agent asks", visible=False)
        with self._folder:
            self._text = panels.server.gui.add_markdown("")
            button(panels, "Approve", Icon.CHECK, lambda: self._answer(approve=True), moves=True)
            button(panels, "Decline", Icon.X, lambda: self._answer(approve=False))

    def draw(self) -> None:
        """Show the question, if there is one."""
        asked = self._asked
        open_now = asked is not None and time.monotonic() - asked[1] < _GONE and asked[0].question != self._answered
        if open_now and asked is not None:
            put(self._text, asked[0].text.replace("`", "'"), "content")
        put(self._folder, open_now, "visible")

    def _on_question(self, _: str, question: AgentQuestion) -> None:
        self._asked = question, time.monotonic()

    @cached_property
    def _answers(self) -> Publisher[AgentAnswer]:
        return self._connection.publisher(self._connection.keys.agent_answer)

    def _answer(self, *, approve: bool) -> None:
        if self._asked is not None:
            self._answers.put(AgentAnswer(question=self._asked[0].question, approve=approve))
            self._answered = self._asked[0].question
