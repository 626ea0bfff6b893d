"""Typed messages over one Zenoh session: serve and call, publish and subscribe, latched values, liveliness."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from types import TracebackType
from typing import Any, Generic, Self, TypeVar

import zenoh

from zarm_contract._model import Message
from zarm_contract.codec import decode, encode, schema
from zarm_contract.errors import Busy, InternalError, InvalidRequest, Problem, Unavailable, ZarmError, from_problem
from zarm_contract.keys import parse_alive
from zarm_contract.session import DEFAULT_ENDPOINT, open_client

log = logging.getLogger(__name__)

Request = TypeVar("Request", bound=Message)
Reply = TypeVar("Reply", bound=Message)
M = TypeVar("M", bound=Message)


class Bus:
    """One session. Use it in `with`; leaving closes every entity and waits for handlers that still run."""

    def __init__(self, endpoint: str = DEFAULT_ENDPOINT, *, timeout: float = 5.0) -> None:
        self._session = open_client(endpoint, timeout)
        self._pools: list[ThreadPoolExecutor] = []
        self._entities: list[Any] = []

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Undeclare everything, finish running handlers, close the session. Idempotent."""
        while self._entities:
            self._entities.pop().undeclare()
        while self._pools:
            self._pools.pop().shutdown(wait=True, cancel_futures=True)
        if not self._session.is_closed():
            self._session.close()

    # -- queries --

    def serve(
        self,
        key: str,
        request: type[Request],
        handler: Callable[[Request], Message],
        *,
        workers: int = 2,
        backlog: int = 16,
    ) -> None:
        """Answer queries on `key` with `handler(request)`, run by up to `workers` threads of this key's own.

        A ZarmError raised by the handler is the answer; any other exception is logged with its trace and answered as
        `internal`. With `workers` + `backlog` queries in hand a further one is answered `busy`.
        """
        room = threading.BoundedSemaphore(workers + backlog)
        pool = ThreadPoolExecutor(workers, thread_name_prefix=key)

        def answer(query: zenoh.Query) -> None:
            try:
                with query:
                    _reply(query, key, lambda: handler(decode(request, _bytes(query.payload))))
            finally:
                room.release()

        def admit(query: zenoh.Query) -> None:
            if not room.acquire(blocking=False):
                with query:
                    _reply_problem(query, Busy(f"{key} has {workers + backlog} requests in hand; try again later"))
                return
            try:
                pool.submit(answer, query)
            except RuntimeError:  # the pool is shut down: this service is closing
                room.release()
                with query:
                    _reply_problem(query, Unavailable(f"{key} is shutting down"))

        self._pools.append(pool)
        self._entities.append(self._session.declare_queryable(key, admit, complete=True))

    def call(self, key: str, request: Message, reply: type[Reply], *, timeout: float) -> Reply:
        """Send a request and return its answer.

        Raises the ZarmError that the service answers, or Unavailable when nobody answers within `timeout` s.
        """
        unavailable = Unavailable(f"no answer on {key} within {timeout:g} s; `zarm status` shows which services run")
        try:
            replies = self._session.get(
                key,
                payload=encode(request),
                encoding=_encoding(type(request)),
                timeout=timeout,
                congestion_control=zenoh.CongestionControl.BLOCK,
            )
            first = next(iter(replies), None)
        except zenoh.ZError as error:
            raise unavailable from error
        if first is None:
            raise unavailable
        if first.ok is not None:
            return decode(reply, first.ok.payload.to_bytes())
        if first.err is None:
            raise unavailable
        try:
            problem = decode(Problem, first.err.payload.to_bytes())
        except InvalidRequest:  # Zenoh's own error reply, a timeout for one, is no Problem
            raise unavailable from None
        raise from_problem(problem)

    # -- publications --

    def publisher(self, key: str, model: type[M], *, realtime: bool = False) -> Publisher[M]:
        """Publish messages of one class on `key`. `realtime`: express, highest priority, dropped rather than queued."""
        entity = self._session.declare_publisher(
            key,
            encoding=_encoding(model),
            congestion_control=zenoh.CongestionControl.DROP if realtime else zenoh.CongestionControl.BLOCK,
            priority=zenoh.Priority.REAL_TIME if realtime else zenoh.Priority.DATA,
            express=realtime,
        )
        self._entities.append(entity)
        return Publisher(entity)

    def latched(self, key: str, model: type[M]) -> Latched[M]:
        """A value that is published on every change and answered to whoever asks for it.

        `key` may end in `/*`: then it is a family of values, each under a key of its own.
        """
        latched = Latched(self._session, key, model)
        self._entities.append(latched)
        return latched

    def subscribe(self, key: str, model: type[M], callback: Callable[[str, M], None]) -> None:
        """Call `callback(key, message)` for each message on `key`, one at a time. It must return quickly.

        What cannot be read is logged and dropped; so is an exception of the callback.
        """

        def receive(sample: zenoh.Sample) -> None:
            if sample.kind == zenoh.SampleKind.PUT:
                _deliver(str(sample.key_expr), sample.payload.to_bytes(), model, callback)

        self._entities.append(self._session.declare_subscriber(key, receive))

    def watch(self, key: str, model: type[M], callback: Callable[[str, M], None], *, timeout: float = 1.0) -> None:
        """Like `subscribe` on a latched key, and the present values first (waiting for them at most `timeout` s)."""
        self.subscribe(key, model, callback)
        for reply in self._session.get(key, timeout=timeout):
            if reply.ok is not None:
                _deliver(str(reply.ok.key_expr), reply.ok.payload.to_bytes(), model, callback)

    def latest(self, key: str, model: type[M]) -> Latest[M]:
        """The newest message on a key with a high rate; nothing is decoded until it is asked for."""
        latest = Latest(self._session, key, model)
        self._entities.append(latest)
        return latest

    # -- liveliness --

    def declare_alive(self, key: str) -> None:
        """Show this process on the bus as long as the session lives; `key` is `Keys.alive(service, instance)`."""
        self._entities.append(self._session.liveliness().declare_token(key))

    def alive(self, key: str, *, timeout: float = 1.0) -> list[tuple[str, str, str]]:
        """`(robot, service, instance)` of each liveliness token that matches `key`, sorted."""
        tokens = self._session.liveliness().get(key, timeout=timeout)
        return sorted({parse_alive(str(reply.ok.key_expr)) for reply in tokens if reply.ok is not None})


class Publisher(Generic[M]):
    """Publishes messages of one class on one key."""

    def __init__(self, entity: zenoh.Publisher) -> None:
        self._entity = entity

    def put(self, message: M) -> None:
        """Publish."""
        self._entity.put(encode(message))


class Latched(Generic[M]):
    """See `Bus.latched`."""

    def __init__(self, session: zenoh.Session, key: str, model: type[M]) -> None:
        self._session = session
        self._key = key
        self._encoding = _encoding(model)
        self._values: dict[str, bytes] = {}
        self._lock = threading.Lock()
        self._queryable = session.declare_queryable(key, self._answer, complete=True)

    def set(self, message: M, *, key: str | None = None) -> None:
        """Change the value and publish it; `key` names the member of a family."""
        key = key or self._key
        payload = encode(message)
        with self._lock:  # publications leave in the order in which the value changed
            self._values[key] = payload
            self._session.put(key, payload, encoding=self._encoding)

    def forget(self, key: str) -> None:
        """Drop one member of a family; it is no longer answered."""
        with self._lock:
            self._values.pop(key, None)

    def undeclare(self) -> None:
        """Answer no more."""
        self._queryable.undeclare()

    def _answer(self, query: zenoh.Query) -> None:
        with query:
            with self._lock:
                values = [(k, v) for k, v in self._values.items() if query.key_expr.intersects(zenoh.KeyExpr(k))]
            for key, payload in values:
                query.reply(key, payload, encoding=self._encoding)


class Latest(Generic[M]):
    """See `Bus.latest`."""

    def __init__(self, session: zenoh.Session, key: str, model: type[M]) -> None:
        self._model = model
        self._newest: tuple[bytes, float] | None = None
        self._changed = threading.Condition()
        self._subscriber = session.declare_subscriber(key, self._receive)

    def get(self, *, max_age: float | None = None) -> M | None:
        """The newest message, or None when there is none, or none received within the last `max_age` s."""
        newest = self._newest
        if newest is None or (max_age is not None and time.monotonic() - newest[1] > max_age):
            return None
        return decode(self._model, newest[0])

    def wait(self, timeout: float) -> M | None:
        """The next message that arrives, or None after `timeout` s."""
        with self._changed:
            before = self._newest
            self._changed.wait_for(lambda: self._newest is not before, timeout)
            after = self._newest
        return decode(self._model, after[0]) if after is not None and after is not before else None

    def undeclare(self) -> None:
        """Receive no more."""
        self._subscriber.undeclare()

    def _receive(self, sample: zenoh.Sample) -> None:
        with self._changed:
            self._newest = (sample.payload.to_bytes(), time.monotonic())
            self._changed.notify_all()


def _encoding(model: type[Message]) -> zenoh.Encoding:
    return zenoh.Encoding.APPLICATION_JSON.with_schema(schema(model))


def _bytes(payload: zenoh.ZBytes | None) -> bytes:
    return payload.to_bytes() if payload is not None else b""


def _reply(query: zenoh.Query, key: str, work: Callable[[], Message]) -> None:
    try:
        message = work()
    except ZarmError as error:
        _reply_problem(query, error)
    except Exception:
        log.exception("handler failed key=%s", key)
        _reply_problem(query, InternalError(f"{key} failed on this request; its log holds the trace"))
    else:
        query.reply(key, encode(message), encoding=_encoding(type(message)))


def _reply_problem(query: zenoh.Query, error: ZarmError) -> None:
    query.reply_err(encode(error.problem), encoding=_encoding(Problem))


def _deliver(key: str, payload: bytes, model: type[M], callback: Callable[[str, M], None]) -> None:
    try:
        callback(key, decode(model, payload))
    except InvalidRequest as error:
        log.warning("dropped a message key=%s reason=%s", key, error)
    except Exception:
        log.exception("subscriber failed key=%s", key)
