"""Agents that move the robot through tools."""

from __future__ import annotations

from zarm_contract._model import Message, ShortMessage
from zarm_contract.messages.motion import Name


class AgentCall(Message):
    """A call of a `tool` at the time `stamp` (Unix, s): its `arguments` as JSON, and its `outcome`, "done" or why not."""

    stamp: float
    tool: Name
    arguments: str
    outcome: str


class AgentQuestion(ShortMessage):
    """A person has to approve what an agent wants: a call of a `tool`, in words. Repeated twice a second until it is answered or given up."""

    question: Name
    tool: Name
    text: str


class AgentAnswer(ShortMessage):
    """A person's answer to a `question`."""

    question: Name
    approve: bool
