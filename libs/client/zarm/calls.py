"""The common base of the client's calls of one robot's services."""

from __future__ import annotations

from typing import TypeVar

from zarm.connection import ANSWER_SECONDS, Connection
from zarm_contract.keys import Keys
from zarm_contract.messages import Message

M = TypeVar("M", bound=Message)


class Calls:
    """Calls of the services of one robot."""

    def __init__(self, connection: Connection) -> None:
        self.connection = connection

    @property
    def name(self) -> str:
        """Its name on the bus."""
        return self.connection.keys.robot

    @property
    def _keys(self) -> Keys:
        return self.connection.keys

    def _ask(self, key: str, reply: type[M], request: Message | None = None, *, timeout: float = ANSWER_SECONDS) -> M:
        return self.connection.ask(key, reply, request, timeout=timeout)
