"""Typed messages over one Zenoh session: serve and call, publish and subscribe, latched values, liveliness."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from types import TracebackType
from typing import Any, Self, TypeVar

import zenoh
from zenoh.handlers import FifoChannel

from zarm_contract.access import Verb, reading, require
from zarm_contract.codec import MAX_BYTES, encode
from zarm_contract.errors import InvalidRequest
from zarm_contract.key import Latched, Published, Query, Token
from zarm_contract.keys import ALL_CLIENTS, client_token, parse_alive
from zarm_contract.messages import Message, Requester
from zarm_contract.roles import Role
from zarm_runtime import clock
from zarm_runtime.arrivals import Arrivals
from zarm_runtime.following import Following
from zarm_runtime.publications import (
    Encoded,
    LatchedPublisher,
    Latest,
    Observer,
    Publisher,
    closed,
    deliver,
    encoding_of,
    understood,
    unobserved,
)
from zarm_runtime.queries import Reply, Request, Served, ask
from zarm_runtime.quota import Quota
from zarm_runtime.security import client_role, security_on
from zarm_runtime.session import DEFAULT_ENDPOINT, open_client, resolved_endpoint

__all__ = ["Bus", "LatchedPublisher", "Latest", "Publisher"]

log = logging.getLogger(__name__)

M = TypeVar("M", bound=Message)

_WAITING = 1024
"""Messages that may wait on each key taken in order, until it is next polled."""
OWNERS_BACK, READ_AGAIN = 2.0, 0.1
"""s: after a link is restored, a latched key without an answer is read repeatedly for the first, at intervals of the
second: routes are known a moment later, and after a restart of the router the owner of the value may return half a
second later.
"""


class Bus:
    """One session. Use it in `with`; leaving closes every entity and waits for handlers that still run. After that every
    method raises Unavailable.

    With ZARM_SECURITY on it has the rights of its `role` (default: ZARM_ROLE): what the role may not do raises
    InvalidRequest at once instead of getting no answer from the router.
    """

    def __init__(self, endpoint: str = DEFAULT_ENDPOINT, *, timeout: float = 5.0, role: Role | None = None) -> None:
        self.role = (role or client_role()) if security_on() else None
        self.endpoint = resolved_endpoint(endpoint)
        self.urgent: Callable[[], bool] = lambda: True
        """Whether messages served or subscribed to in order must be noticed within 2 ms now, or within 10 ms, which
        saves CPU.
        """
        self._opened = open_client(endpoint, timeout, self.role)
        self._pools: list[ThreadPoolExecutor] = []
        self._client = str(self._session.info.zid())
        self._entities: list[Any] = [self._session.liveliness().declare_token(client_token(self._client))]
        self._followed: list[Following] = []
        self._sees_links = False
        self._closing = threading.Event()
        self._ordered: Arrivals | None = None
        self._observe: Observer = unobserved
        self._answered: Callable[[str, str], object] = unobserved

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Undeclare everything, finish running handlers, close the session. Idempotent."""
        self._closing.set()
        if self._ordered is not None:
            self._ordered.close()
        while self._entities:
            self._entities.pop().undeclare()
        while self._pools:
            self._pools.pop().shutdown(wait=True, cancel_futures=True)
        self._opened.close()

    def check_open(self) -> None:
        """Raise Unavailable after `close`."""
        if self._opened.is_closed():
            raise closed()

    @property
    def _session(self) -> zenoh.Session:
        self.check_open()
        return self._opened

    @property
    def connected(self) -> bool:
        """Whether the session has a router now."""
        return bool(self._session.info.routers_zid())

    def observe(self, observer: Observer) -> None:
        """From now on pass every publication sent or received on this bus to `observer`."""
        self._observe = observer

    def watch_answers(self, answered: Callable[[str, str], object]) -> None:
        """From now on call `answered` for every query answered here: its key, and `ok` or the code of the problem."""
        self._answered = answered

    # -- queries --

    def serve(
        self,
        key: Query[Request, Reply],
        handler: Callable[[Request], Reply | Encoded],
        *,
        workers: int = 2,
        backlog: int = 16,
        shared: bool = False,
    ) -> None:
        """Answer queries on `key` with `handler(request)`, run by up to `workers` threads of this key's own.

        A ZarmError raised by the handler is the answer; any other exception is logged with its trace and answered as
        `internal`. With `workers` + `backlog` queries pending, a further one is answered `busy`. If they are `shared`,
        no client has more of them pending than there is room left for others. `requester` tells the handler for whom it
        works. An answer that cannot be sent is logged with its trace, with the outcome `unsent`.

        A query whose key expression only matches `key` (`zarm/**`) is ignored, so that exploring the bus never moves a
        robot; `readable` keys, where an empty request reads, answer it if it carries no payload.
        """
        room = Quota(key, workers + backlog, shared=shared)
        self._serve(key, lambda asked, _: handler(asked), workers, room, in_order=False)

    def serve_in_order(
        self,
        key: Query[Request, Reply],
        handler: Callable[[Request, int], Reply | Encoded],
        *,
        workers: int = 2,
        backlog: int = 16,
        overtaken: bool = True,
    ) -> None:
        """Like `serve`, but `handler(request, arrival)` is also given the arrival number of each query.

        Arrivals are numbered across all keys served or subscribed to in order on this bus, before a query waits for a
        worker or is decoded. A query that may be `overtaken` never has a larger number than one that may not and came
        after it; if it came within some milliseconds after it, it may have a smaller one.
        """
        room = Quota(key, workers + backlog, shared=False)
        self._serve(key, handler, workers, room, in_order=True, overtaken=overtaken)

    def _serve(
        self,
        key: Query[Request, Reply],
        handler: Callable[[Request, int], Reply | Encoded],
        workers: int,
        room: Quota,
        *,
        in_order: bool,
        overtaken: bool = True,
    ) -> None:
        self._require("answers", key)
        served = Served(
            key,
            handler,
            workers,
            room,
            lambda name, outcome: self._answered(name, outcome),  # watchers may be added later
        )
        self._pools += served.pools
        if in_order:
            queryable: Any = self._session.declare_queryable(key, FifoChannel(_WAITING), complete=True)
            self._arrivals().add(queryable, served.admit, overtaken=overtaken)
        else:
            queryable = self._session.declare_queryable(key, served.admit, complete=True)
        self._entities.append(queryable)

    def call(self, key: Query[Request, Reply], request: Request, *, timeout: float) -> Reply:
        """Send a request and return its answer.

        Raises InvalidRequest for a request that no router passes on, the service's ZarmError, Unavailable if nobody
        answers within `timeout` s, or InternalError if the answer cannot be read.
        """
        self._require("asks", key)
        payload = encode(request)
        if len(payload) > MAX_BYTES:
            raise InvalidRequest(
                f"the request of {len(payload)} bytes is over the limit of {MAX_BYTES}; send less at once",
                field="payload",
            )
        requester = Requester(client=self._client, timeout=max(0.0, timeout))
        return ask(
            self._session,
            key,
            key.reply,
            timeout,
            self.role,
            payload=payload,
            encoding=encoding_of(type(request)),
            attachment=encode(requester),
        )

    def read(self, key: Latched[M], *, timeout: float) -> M:
        """The present value of a key. Raises Unavailable and InternalError as `call` does."""
        return ask(self._session, reading(key), key.model, timeout, self.role)

    def _arrivals(self) -> Arrivals:
        if self._ordered is None:
            self._ordered = Arrivals(lambda: self.urgent())
        return self._ordered

    # -- publications --

    def publisher(self, key: Published[M]) -> Publisher[M]:
        """The means to publish messages on `key`."""
        self._require("publishes", key)
        entity = self._session.declare_publisher(
            key,
            encoding=encoding_of(key.model),
            congestion_control=zenoh.CongestionControl.DROP if key.droppable else zenoh.CongestionControl.BLOCK,
            priority=zenoh.Priority.REAL_TIME if key.realtime else zenoh.Priority.DATA,
            express=key.realtime,
        )
        self._entities.append(entity)
        return Publisher(entity, self._observe)

    def latched(self, key: Latched[M]) -> LatchedPublisher[M]:
        """A value that is published on every change, and answered on request; a family of values, if `key` ends in
        `/*`.

        A `Setting` is not latched but served and published: `serve` answers reads, and a key has only one queryable.
        """
        self._require("answers", key)
        latched: LatchedPublisher[M] = LatchedPublisher(self._session, key, self._observe)
        self._entities.append(latched)
        return latched

    def subscribe(self, key: Published[M], callback: Callable[[str, M], None]) -> Callable[[], None]:
        """Call `callback(key, message)` for each message on `key`, one at a time. It must return quickly. Returns a
        function that ends it.

        Unreadable messages are logged and dropped; so are exceptions of the callback.
        """
        return self.listen(key, lambda name, payload: deliver(name, payload, key.model, callback))

    def subscribe_timed(self, key: Published[M], callback: Callable[[M, float], None]) -> None:
        """Like `subscribe`, but the callback is also given the time of arrival (s, monotonic), before decoding."""

        def receive(name: str, payload: bytes) -> None:
            arrived = clock.monotonic()
            deliver(name, payload, key.model, lambda _, message: callback(message, arrived))

        self.listen(key, receive)

    def listen(self, key: str, callback: Callable[[str, bytes], None]) -> Callable[[], None]:
        """Call `callback(key, payload)` for each message on `key`, unread and unchecked; returns a function that ends
        it.

        Nothing is decoded, so high rates are no burden as long as the callback does next to nothing.
        """
        return self._listen(key, lambda name, payload, _: callback(name, payload), in_order=False)

    def subscribe_in_order(
        self, key: Published[M], callback: Callable[[str, M, int], None], *, backlog: int = 64
    ) -> None:
        """Like `subscribe`, but the callback is also given each message's arrival number, as in `serve_in_order`.

        Messages that arrive while `backlog` others wait for the callback are logged and dropped.
        """
        room = threading.BoundedSemaphore(backlog)
        pool = ThreadPoolExecutor(1, thread_name_prefix=key)

        def hand_over(name: str, payload: bytes, arrival: int) -> None:
            try:
                deliver(name, payload, key.model, lambda _, message: callback(name, message, arrival))
            finally:
                room.release()

        def receive(name: str, payload: bytes, arrival: int) -> None:
            if not room.acquire(blocking=False):
                log.warning("dropped a message key=%s reason=%d_wait_already", name, backlog)
                return
            try:
                pool.submit(hand_over, name, payload, arrival)
            except RuntimeError:  # the pool is shut down: this service is closing
                room.release()

        self._pools.append(pool)
        self._listen(key, receive, in_order=True)

    def _listen(self, key: str, callback: Callable[[str, bytes, int], None], *, in_order: bool) -> Callable[[], None]:
        self._require("reads", key)
        observe = self._observe

        def receive(sample: zenoh.Sample, arrival: int = 0) -> None:
            if understood(sample):
                name, payload = str(sample.key_expr), sample.payload.to_bytes()
                observe(name, payload)
                callback(name, payload, arrival)

        if in_order:
            subscriber: Any = self._session.declare_subscriber(key, FifoChannel(_WAITING))
            self._arrivals().add(subscriber, receive, overtaken=True)
        else:
            subscriber = self._session.declare_subscriber(key, receive)
        self._entities.append(subscriber)

        def end() -> None:
            with suppress(ValueError):  # the bus is closed, and with it the entity
                self._entities.remove(subscriber)
                subscriber.undeclare()

        return end

    def watch(self, key: Latched[M], callback: Callable[[str, M], None], *, timeout: float = 1.0) -> Callable[[], None]:
        """Like `subscribe` on a latched key, but with the present values first (waiting for them at most `timeout` s);
        returns a function that ends it.

        They are delivered again whenever a lost link to a router is restored, since publications were missed meanwhile.
        The last call for a key always has its newest value.
        """
        return self.follow(key, lambda name, payload: deliver(name, payload, key.model, callback), timeout=timeout)

    def follow(self, key: str, callback: Callable[[str, bytes], None], *, timeout: float = 1.0) -> Callable[[], None]:
        """`watch` without decoding: like `listen` on a latched key, but with the present values first."""
        if not self._sees_links:
            self._sees_links = True
            self._entities.append(self._session.info.declare_transport_events_listener(self._linked))
        following = Following(self._session, key, callback, self._observe, timeout)
        self._followed.append(following)
        unlisten = self.listen(key, following.receive)
        following.read()

        def end() -> None:
            with suppress(ValueError):  # ended before
                self._followed.remove(following)
            unlisten()

        return end

    def _linked(self, event: zenoh.TransportEvent) -> None:
        """Called in its own thread when a link to a router is established or lost."""
        if event.kind != zenoh.SampleKind.PUT:
            return
        unanswered, deadline = list(self._followed), time.monotonic() + OWNERS_BACK
        while (unanswered := [one for one in unanswered if not one.read()]) and time.monotonic() < deadline:
            if self._closing.wait(READ_AGAIN):
                return

    def latest(self, key: Published[M]) -> Latest[M]:
        """The newest message on a high-rate key; it is decoded only when requested."""
        latest = Latest(self._session, key, self._observe)
        self._entities.append(latest)
        return latest

    # -- liveliness --

    def declare_alive(self, key: Token) -> None:
        """Show this process on the bus as long as the session lives."""
        self._require("lives", key)
        self._entities.append(self._session.liveliness().declare_token(key))

    def alive(self, key: str, *, timeout: float = 1.0) -> list[tuple[str, str, str]]:
        """`(robot, service, instance)` of each liveliness token that matches `key`, sorted."""
        tokens = self._session.liveliness().get(key, timeout=timeout)
        return sorted({parse_alive(str(reply.ok.key_expr)) for reply in tokens if reply.ok is not None})

    def watch_clients(self, gone: Callable[[str], object]) -> None:
        """Call `gone(client)` with each `Requester.client` that can no longer be answered: it has left, or the link to
        it is lost.
        """

        def changed(sample: zenoh.Sample) -> None:
            if sample.kind == zenoh.SampleKind.DELETE:
                gone(str(sample.key_expr).rpartition("/")[2])

        self._entities.append(self._session.liveliness().declare_subscriber(ALL_CLIENTS, changed))

    def is_there(self, client: str, *, timeout: float = 1.0) -> bool:
        """Whether an answer can reach the `Requester.client`, as far as the router knows; waits up to `timeout` s for
        that, because over a new link its requests may come before its token.
        """
        until = time.monotonic() + timeout
        while True:
            tokens = self._session.liveliness().get(client_token(client), timeout=timeout)
            if any(reply.ok is not None for reply in tokens):
                return True
            if time.monotonic() > until or self._closing.wait(READ_AGAIN):
                return False

    # -- access --

    def _require(self, verb: Verb, key: str) -> None:
        if self.role is not None:
            require(self.role, verb, key)
