"""Agents that move the robot through tools."""

from __future__ import annotations

from zarm_contract._model import Message
from zarm_contract.messages.motion import Name


class AgentCall(Message):
    """A call of a `tool` at the time `stamp` (Unix, s): its `arguments` as JSON, and its `outcome`, "done" or why not."""

    stamp: float
    tool: Name
    arguments: str
    outcome: str
