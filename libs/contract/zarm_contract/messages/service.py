"""Requests that every service answers."""

from __future__ import annotations

from typing import Annotated

from pydantic import ConfigDict, Field

from zarm_contract._model import Message, ShortMessage
from zarm_contract.messages.motion import Name, NonNegative


class Nothing(ShortMessage):
    """An empty request: `{}` or no payload. It is accepted from every version of the contract: a stop is a stop."""

    any_contract = True


class Requester(ShortMessage):
    """Who sends a request, and how long it waits for the answer: `timeout` (s). It is the attachment of the query.

    `client` is the id of the Zenoh session. Its liveliness token shows that an answer can still reach the client.
    """

    client: Name
    timeout: NonNegative


class Health(Message):
    """What a service is. `activity` says what it does until it is `ready`; `uptime` is in s; `note` holds other information.

    It is accepted from every version of the contract: unknown fields are ignored.
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
    note: str = ""
