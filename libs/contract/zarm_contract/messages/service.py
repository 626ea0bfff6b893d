"""What every service is asked."""

from __future__ import annotations

from typing import Annotated

from pydantic import ConfigDict, Field

from zarm_contract._model import Message, ShortMessage
from zarm_contract.messages.motion import Name, NonNegative


class Nothing(ShortMessage):
    """A request without content: `{}` or no payload at all. Whoever sends it may speak any version: a stop is a stop."""

    any_contract = True


class Asker(ShortMessage):
    """Who sends a request, and how long, in s, it waits for the answer; it is the attachment of the query.

    `client` is the id of its Zenoh session, whose liveliness token shows that an answer can still reach it.
    """

    client: Name
    patience: NonNegative


class Health(Message):
    """How a service is. `activity` says what it is busy with while not `ready`; `uptime` in s.

    It tells who runs which version, so it is read from every version: fields that a later one adds are passed over.
    """

    any_contract = True
    model_config = ConfigDict(extra="ignore")

    service: Name
    robot: Name
    instance: Name
    ready: bool
    activity: str
    version: str
    contract: str
    robot_hash: str
    uptime: NonNegative
    pid: Annotated[int, Field(gt=0)]
