"""The kinds of key: each is a key expression with its messages, rights and purpose."""

from __future__ import annotations

import re
from abc import abstractmethod
from dataclasses import dataclass
from typing import Any, Generic, Literal, Self, TypeVar

from zarm_contract._model import Message
from zarm_contract.roles import EVERYONE, SERVICE_ROLES, Role, Roles

M = TypeVar("M", bound=Message)
Request = TypeVar("Request", bound=Message)
Reply = TypeVar("Reply", bound=Message)
K = TypeVar("K", bound="Key")

Recorded = Literal["changes", "value and changes", "with the scene"]
"""What a record holds of a key: what is published after it began, or also the value from before; of some only where the scene is recorded too."""

_NAME = re.compile(r"<\w+>")


@dataclass(frozen=True)
class Rights:
    """What each role may do on a key: publish, answer requests, send requests to exactly this key, which may act, declare
    the key as its liveliness token, or read what is published.

    `latched`: who may read what is published may read the present value, through `reading(key)`, which no service takes for a
    request to act.
    """

    publishes: Roles = ()
    answers: Roles = ()
    asks: Roles = ()
    lives: Roles = ()
    reads: Roles = EVERYONE
    latched: bool = False


class Key(str):
    """A key expression: of any robot (`zarm/*/planner/plan`) as an attribute of the class `Keys`, of one robot as an
    attribute of an instance.

    `path` follows `zarm/<robot>/`, with each name that varies in angle brackets. `about` states the purpose in one line.
    """

    kind: str
    robot: str
    path: str
    about: str
    rights: Rights
    recorded: Recorded | None = None

    def __new__(cls, path: str, about: str) -> Self:
        self = str.__new__(cls, f"zarm/*/{_NAME.sub('*', path)}")
        self.robot, self.path, self.about = "*", path, about
        return self

    def __get__(self, keys: Any, owner: type) -> Self:
        return self if keys is None else self.of_robot(keys.robot)

    def of_robot(self, robot: str) -> Self:
        """This key of one robot."""
        made = self.at(f"zarm/{robot}/{_NAME.sub('*', self.path)}")
        made.robot = robot
        return made

    def named(self, *names: str) -> Self:
        """This key with each name that varies. Raises TypeError for another number of names."""
        varying = _NAME.findall(self.path)
        if len(names) != len(varying):
            raise TypeError(f"{self.path} takes {len(varying)} names, not {len(names)}")
        rest = iter(names)
        return self.at(f"zarm/{self.robot}/{_NAME.sub(lambda _: next(rest), self.path)}")

    def at(self, expression: str) -> Self:
        """The same kind of key at another key expression."""
        made = str.__new__(type(self), expression)
        vars(made).update(vars(self))
        return made

    @property
    @abstractmethod
    def messages(self) -> str:
        """The names of the messages."""


class Published(Key, Generic[M]):
    """A key on which messages of one class are published.

    `realtime`: express, with the highest priority. On a congested link, `droppable` messages are dropped rather than
    queued.
    """

    model: type[M]
    realtime: bool = False
    droppable: bool = False
    subclasses: tuple[type[Message], ...] = ()
    """The classes of the messages, where `model` is their common base."""

    @property
    def messages(self) -> str:
        """The names of the messages."""
        *others, last = (model.__name__ for model in self.subclasses or (self.model,))
        return f"{', '.join(others)} or {last}" if others else last


class Topic(Published[M]):
    """What the roles `by` publish and the `readers` may read; nobody answers. By default those that are `realtime` are droppable."""

    kind = "publication"

    def __new__(
        cls,
        path: str,
        model: type[M],
        about: str,
        *,
        by: Roles,
        readers: Roles = EVERYONE,
        realtime: bool = False,
        droppable: bool | None = None,
        recorded: Recorded | None = None,
    ) -> Self:
        self = Key.__new__(cls, path, about)
        self.model, self.recorded = model, recorded
        self.realtime, self.droppable = realtime, realtime if droppable is None else droppable
        self.rights = Rights(publishes=by, reads=readers)
        return self


class BinaryTopic(Topic[M]):
    """Images or clouds: a message, the end of the line, and the bytes of pixels or points."""

    @property
    def messages(self) -> str:
        """The name of the header."""
        return f"{self.model.__name__} and bytes"


class Latched(Published[M]):
    """A value of the role `of`, published on every change, and answered to its `readers`."""

    kind = "latched"

    def __new__(
        cls,
        path: str,
        model: type[M],
        about: str,
        *,
        of: Role,
        readers: Roles = EVERYONE,
        recorded: Recorded | None = None,
        subclasses: tuple[type[Message], ...] = (),
    ) -> Self:
        self = Key.__new__(cls, path, about)
        self.model, self.recorded, self.subclasses = model, recorded, subclasses
        self.rights = Rights(publishes=(of,), answers=(of,), asks=readers, reads=readers, latched=True)
        return self


class Query(Key, Generic[Request, Reply]):
    """Requests of the roles `by`, answered by the role `to`. Those that are `readable` everyone may send empty, which
    only reads.
    """

    request: type[Request]
    reply: type[Reply]
    readable: bool

    def __new__(
        cls,
        path: str,
        request: type[Request],
        reply: type[Reply],
        about: str,
        *,
        to: Role | None = None,
        by: Roles,
        readable: bool = False,
    ) -> Self:
        self = Key.__new__(cls, path, about)
        self.kind = "query, readable" if readable else "query"
        self.request, self.reply, self.readable = request, reply, readable
        self.rights = Rights(answers=() if to is None else (to,), asks=by, latched=readable)
        return self

    @property
    def messages(self) -> str:
        """The names of request and reply."""
        return f"{self.request.__name__} -> {self.reply.__name__}"


class Setting(Query[Request, M], Latched[M]):
    """A value that is latched, and that the roles `by` may change by requests."""

    def __new__(
        cls,
        path: str,
        request: type[Request],
        model: type[M],
        about: str,
        *,
        of: Role,
        by: Roles,
        recorded: Recorded | None = None,
    ) -> Self:
        self = Key.__new__(cls, path, about)
        self.kind = "latched; query"
        self.request, self.reply, self.model, self.readable, self.recorded = request, model, model, True, recorded
        self.rights = Rights(publishes=(of,), answers=(of,), asks=by, latched=True)
        return self


class Token(Key):
    """A liveliness token: it exists as long as its process runs."""

    kind = "liveliness token"
    messages = "Liveliness token"

    def __new__(cls, path: str, about: str) -> Self:
        self = Key.__new__(cls, path, about)
        self.rights = Rights()
        return self


class Family(Generic[K]):
    """Keys of one kind that differ in a name: `keys.goal("*")` stands for all of them."""

    def __init__(self, key: K) -> None:
        self.key = key

    def __get__(self, keys: Any, owner: type) -> Self:
        return self if keys is None else type(self)(self.key.of_robot(keys.robot))

    def __call__(self, *names: str) -> K:
        return self.key.named(*names)


class OfService(Family[K]):
    """A key that each service has for itself: the first name is the service, which gives the key its owner."""

    def __call__(self, *names: str) -> K:
        key = super().__call__(*names)
        role = SERVICE_ROLES.get(names[0])
        owner: Roles = () if role is None else (role,)
        key.rights = (
            Rights(lives=owner)
            if isinstance(key, Token)
            else Rights(answers=owner, asks=key.rights.asks, latched=key.rights.latched)
        )
        return key
