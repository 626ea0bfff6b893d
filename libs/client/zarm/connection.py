"""A session with the services of one robot, or with a bus that has several."""

from __future__ import annotations

import os
from collections.abc import Callable, Generator, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any, TypeVar

from zarm.goals import Goals
from zarm.interrupts import CtrlC, Interrupts
from zarm.live import Newest, live
from zarm_contract.errors import InvalidRequest, Unavailable
from zarm_contract.key import Latched, Published, Query
from zarm_contract.keys import ALL_ALIVE, Keys
from zarm_contract.messages import Message
from zarm_contract.roles import Role
from zarm_runtime import clock
from zarm_runtime.bus import Bus, Publisher
from zarm_runtime.session import DEFAULT_ENDPOINT

CONNECT_SECONDS = 2.0
ANSWER_SECONDS = 5.0
"""Longest wait (s) for requests that are answered at once."""

M = TypeVar("M", bound=Message)
Request = TypeVar("Request", bound=Message)
Reply = TypeVar("Reply", bound=Message)


@dataclass(frozen=True)
class Connection:
    """A session, the keys of one robot, the states of its goals, and what interrupts calls. Thread-safe."""

    bus: Bus
    keys: Keys
    goals: Goals
    interrupts: Interrupts
    _publishers: dict[str, Publisher[Any]] = field(default_factory=dict)

    @classmethod
    def of(cls, bus: Bus, keys: Keys, interrupts: Interrupts | None = None) -> Connection:
        """A connection to a robot on an open bus."""
        return cls(bus, keys, Goals(bus, keys), interrupts or CtrlC())

    def ask(self, key: Query[Request, Reply], request: Request, *, timeout: float = ANSWER_SECONDS) -> Reply:
        """The answer to a request within `timeout` s. Raises the service's problem, or Unavailable."""
        return self.interrupts.run_interruptibly(lambda: self.bus.call(key, request, timeout=timeout))

    def read(self, key: Latched[M], *, timeout: float = ANSWER_SECONDS) -> M:
        """The present value of a key. Raises Unavailable."""
        return self.interrupts.run_interruptibly(lambda: self.bus.read(key, timeout=timeout))

    def latched(self, key: Latched[M]) -> Generator[M]:
        """The present value of a key and then each new one."""

        def subscribe(emit: Callable[[M], None]) -> Callable[[], None]:
            return self.interrupts.run_interruptibly(lambda: self.bus.watch(key, lambda _, value: emit(value)))

        return live(subscribe, self.interrupts, self.bus.check_open)

    def published(self, key: Published[M]) -> Generator[M]:
        """Each value published on a key from now on."""
        return live(
            lambda emit: self.bus.subscribe(key, lambda _, value: emit(value)), self.interrupts, self.bus.check_open
        )

    def next(self, key: Published[M], seconds: float) -> M | None:
        """The next value published on a key, or None if none comes within `seconds`."""
        newest: Newest[M] = Newest()
        end = self.bus.subscribe(key, lambda _, value: newest.put(value))
        try:
            return self.interrupts.run_interruptibly(lambda: newest.take(seconds))
        finally:
            end()

    def publisher(self, key: Published[M]) -> Publisher[M]:
        """The publisher of a key; the same one for all callers."""
        if key not in self._publishers:
            self._publishers[key] = self.bus.publisher(key)
        return self._publishers[key]


@contextmanager
def connected(
    endpoint: str | None = None,
    name: str | None = None,
    *,
    role: Role | None = None,
    timeout: float = CONNECT_SECONDS,
    interrupts: Interrupts | None = None,
) -> Iterator[Connection]:
    """A connection with the robot `name`, or with the only one on the bus; see `zarm.connect`."""
    name = name if name is not None else os.environ.get("ZARM_NAME")
    with opened(endpoint, role, timeout) as bus:
        yield Connection.of(bus, keys_of(name if name is not None else _only(bus)), interrupts)


def robots(endpoint: str | None = None, *, role: Role | None = None, timeout: float = CONNECT_SECONDS) -> list[str]:
    """The names of the robots with a live service, sorted.

    `endpoint`, `role` and `timeout` (s) are those of `zarm.connect`. Raises Unavailable if no router answers.
    """
    with opened(endpoint, role, timeout) as bus:
        return _alive(bus)


def opened(endpoint: str | None, role: Role | None = None, timeout: float = CONNECT_SECONDS) -> Bus:
    """A session with the router at `endpoint` (default: $ZARM_CONNECT, else this machine's). Raises Unavailable, and
    InvalidRequest for an invalid endpoint.
    """
    clock.read_speed()
    return Bus(endpoint or os.environ.get("ZARM_CONNECT") or DEFAULT_ENDPOINT, timeout=timeout, role=role)


def keys_of(name: str) -> Keys:
    """The keys of a robot. Raises InvalidRequest for an invalid name."""
    try:
        return Keys(name)
    except ValueError as error:
        raise InvalidRequest(str(error), field="name") from error


def _alive(bus: Bus) -> list[str]:
    return sorted({robot for robot, _, _ in bus.alive(ALL_ALIVE)})


def _only(bus: Bus) -> str:
    robots = _alive(bus)
    if not robots:
        raise Unavailable(f"no robot is alive on the bus at {bus.endpoint}; start one with `zarm up`")
    if len(robots) > 1:
        raise InvalidRequest(
            f"several robots are alive at {bus.endpoint}: {', '.join(robots)}; choose one", field="name"
        )
    return robots[0]
