"""The common base of the client's calls of one robot's services."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TypeVar

from zarm.connection import ANSWER_SECONDS, Connection
from zarm_contract.key import Query
from zarm_contract.keys import Keys
from zarm_contract.messages import Message

Request = TypeVar("Request", bound=Message)
Reply = TypeVar("Reply", bound=Message)


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

    def _ask(self, key: Query[Request, Reply], request: Request, *, timeout: float = ANSWER_SECONDS) -> Reply:
        return self.connection.ask(key, request, timeout=timeout)

    @contextmanager
    def _until_left(self) -> Iterator[None]:
        """A block that insists on rest; leaving it earlier gives an explanation of the consequences."""
        try:
            with self.connection.interrupts.insist(f"the executor of {self.name} to bring the robot to rest"):
                yield
        except KeyboardInterrupt:
            raise KeyboardInterrupt(self._unknown()) from None

    def _unknown(self) -> str:
        return (
            f"interrupted: the executor of {self.name} has not answered, and the state of the robot is unknown: make sure that "
            "it stands still, then see `zarm status`"
        )
