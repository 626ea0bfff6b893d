"""Asks a person: on the page, or through the client."""

from __future__ import annotations

import logging
import secrets
from typing import Any

import anyio
from mcp.server.mcpserver import Context
from pydantic import BaseModel, Field

from zarm.connection import Connection
from zarm_contract.errors import ExecutionRefused
from zarm_contract.messages import AgentAnswer, AgentQuestion

log = logging.getLogger(__name__)

_REPEATED = 0.5
"""A question is repeated this often (s), so that a page that is opened later has it."""
_LOOKED = 0.05


class Approve(BaseModel):
    """What a person is asked through the client."""

    approve: bool = Field(description="Let the robot do it.")


class Approvals:
    """Questions and answers on the bus of `connection`; a question is given up after `timeout` s."""

    def __init__(self, connection: Connection, timeout: float) -> None:
        self._timeout = timeout
        self._questions = connection.publisher(connection.keys.agent_question)
        self._answers: dict[str, bool | None] = {}  # to open questions
        connection.bus.subscribe(connection.keys.agent_answer, self._on_answer)

    def _on_answer(self, _: str, answer: AgentAnswer) -> None:
        if answer.question in self._answers:
            self._answers[answer.question] = answer.approve

    async def demand(self, tool: str, text: str, context: Context[Any]) -> None:
        """Raise ExecutionRefused unless a person approves."""
        question = AgentQuestion(question=secrets.token_hex(4), tool=tool, text=text)
        self._answers[question.question] = None

        async def ask_on_page() -> None:
            while self._answers[question.question] is None:
                self._questions.put(question)
                with anyio.move_on_after(_REPEATED):
                    while self._answers[question.question] is None:
                        await anyio.sleep(_LOOKED)
            tasks.cancel_scope.cancel()

        async def ask_client() -> None:
            try:
                answer = await context.elicit(text, Approve)
            except Exception as error:  # a client that cannot ask says so in its own way
                log.info("the client asks nobody tool=%s reason=%s", tool, error)
                return
            self._answers[question.question] = answer.action == "accept" and answer.data.approve
            tasks.cancel_scope.cancel()

        try:
            with anyio.move_on_after(self._timeout):
                async with anyio.create_task_group() as tasks:
                    tasks.start_soon(ask_on_page)
                    tasks.start_soon(ask_client)
        finally:
            approved = self._answers.pop(question.question)
        if approved is None:
            raise ExecutionRefused(
                f"nobody has approved {tool} within {self._timeout:g} s; ask the person to do it here, or on the page (`zarm view`)",
                code="limit_violated",
            )
        if not approved:
            raise ExecutionRefused(f"the person did not approve {tool}; ask what to do instead", code="limit_violated")
