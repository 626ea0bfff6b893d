"""Publishers and subscribers: plain publications, latched values, and the newest message."""

from __future__ import annotations

import logging
import threading
import time
from collections import deque
from collections.abc import Callable
from typing import Any, Generic, NamedTuple, TypeVar

import zenoh

from zarm_contract.codec import CONTRACT, decode, encode, other_contract, schema
from zarm_contract.errors import InvalidRequest, Unavailable
from zarm_contract.key import Published
from zarm_contract.messages import Message
from zarm_runtime import clock

log = logging.getLogger(__name__)

M = TypeVar("M", bound=Message)

Observer = Callable[[str, bytes], None]
"""Receives key and payload of each message; called from any thread, including the control loop, so it must return at
once.
"""


def unobserved(_key: str, _what: object) -> None:
    """The observer of a bus without observers."""


class Encoded(NamedTuple):
    """A message in wire format; one that is both published and answered is encoded once."""

    payload: bytes
    encoding: zenoh.Encoding

    @classmethod
    def of(cls, message: Message) -> Encoded:
        """Encode a message."""
        return cls(encode(message), encoding_of(type(message)))


def closed() -> Unavailable:
    """The error for whatever uses a session that has been closed."""
    return Unavailable(
        "the connection is closed, since its `with` has ended; connect again, and use it inside the `with`"
    )


class Publisher(Generic[M]):
    """Publishes messages of one class on one key."""

    def __init__(self, entity: zenoh.Publisher, observe: Observer) -> None:
        self._entity = entity
        self._key = str(entity.key_expr)
        self._observe = observe

    def put(self, message: M) -> None:
        """Publish. Raises Unavailable after the bus is closed."""
        self.put_encoded(encode(message))

    def put_encoded(self, payload: bytes) -> None:
        """Publish what is in wire format already. Raises Unavailable after the bus is closed."""
        try:
            self._entity.put(payload)
        except zenoh.ZError as error:
            raise closed() from error
        self._observe(self._key, payload)

    def has_subscribers(self) -> bool:
        """Whether it has subscribers now."""
        status: Any = self._entity.matching_status  # Zenoh's stub says bool
        return bool(status.matching)


class LatchedPublisher(Generic[M]):
    """See `Bus.latched`."""

    def __init__(self, session: zenoh.Session, key: str, observe: Observer) -> None:
        self._session = session
        self._key = key
        self._observe = observe
        self._values: dict[str, Encoded] = {}
        self._changes: deque[tuple[str, Encoded]] = deque()
        self._lock = threading.Lock()
        self._order = threading.Lock()
        self._queryable = session.declare_queryable(key, self._answer, complete=True)

    def set(self, message: M, *, key: str | None = None) -> Encoded:
        """Change the value and publish it; `key` names the member of a family. Waits if the link has no room.

        Returns what was published.
        """
        encoded = self.change(message, key=key)
        self.publish()
        return encoded

    def change(self, message: M, *, key: str | None = None) -> Encoded:
        """Like `set`, but published by the next `publish`, which must follow: until then it is only answered."""
        encoded = Encoded.of(message)
        with self._lock:
            self._values[key or self._key] = encoded
            self._changes.append((key or self._key, encoded))
        return encoded

    def publish(self) -> None:
        """Publish the changes, in their order. Waits if the link has no room."""
        with self._order:  # no answer waits for a publication
            while self._changes:
                key, (payload, encoding) = self._changes.popleft()
                # Zenoh would drop it on a link without room, and nobody would ever publish it again.
                self._session.put(key, payload, encoding=encoding, congestion_control=zenoh.CongestionControl.BLOCK)
                self._observe(key, payload)

    def forget(self, key: str) -> None:
        """Drop one member of a family; it is no longer answered."""
        with self._lock:
            self._values.pop(key, None)

    def undeclare(self) -> None:
        """Stop answering."""
        self._queryable.undeclare()

    def _answer(self, query: zenoh.Query) -> None:
        with query:
            with self._lock:
                values = [(k, v) for k, v in self._values.items() if query.key_expr.intersects(zenoh.KeyExpr(k))]
            for key, (payload, encoding) in values:
                query.reply(key, payload, encoding=encoding)


class Latest(Generic[M]):
    """See `Bus.latest`."""

    def __init__(self, session: zenoh.Session, key: Published[M], observe: Observer) -> None:
        self._key = key
        self._observe = observe
        self._newest: tuple[bytes, float] | None = None
        self._decoded: tuple[tuple[bytes, float], M] | None = None
        self._changed = threading.Condition()
        self._subscriber = session.declare_subscriber(key, self._receive)

    def get(self, *, max_age: float | None = None) -> M | None:
        """The newest message, or None if there is none, or none received within the last `max_age` s.

        An unreadable one is logged and dropped.
        """
        newest = self._newest
        if newest is None or (max_age is not None and clock.monotonic() - newest[1] > max_age):
            return None
        return self._read(newest)

    def received(self) -> tuple[M, float] | None:
        """The newest message and its time of arrival (s, monotonic), or None if there is none."""
        newest = self._newest
        if newest is None or (message := self._read(newest)) is None:
            return None
        return message, newest[1]

    def wait(self, timeout: float) -> M | None:
        """The next message, or None after `timeout` s."""
        deadline = time.monotonic() + timeout
        before = self._newest
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._newest not in (None, before), deadline - time.monotonic())
                newest = self._newest
            if newest is None or newest is before:
                return None
            if (message := self._read(newest)) is not None:
                return message

    def undeclare(self) -> None:
        """Stop receiving."""
        self._subscriber.undeclare()

    def _read(self, newest: tuple[bytes, float]) -> M | None:
        decoded = self._decoded
        if decoded is not None and decoded[0] is newest:
            return decoded[1]
        try:
            message = decode(self._key.model, newest[0])
            self._decoded = newest, message
            return message
        except InvalidRequest as error:
            _log_dropped(self._key, error)
            with self._changed:
                if self._newest is newest:
                    self._newest = None
            return None

    def _receive(self, sample: zenoh.Sample) -> None:
        if not understood(sample):
            return
        payload = sample.payload.to_bytes()
        with self._changed:
            self._newest = (payload, clock.monotonic())
            self._changed.notify_all()
        self._observe(str(sample.key_expr), payload)


def encoding_of(model: type[Message]) -> zenoh.Encoding:
    """JSON with the schema name of the message class."""
    return zenoh.Encoding.APPLICATION_JSON.with_schema(schema(model))


def understood(sample: zenoh.Sample) -> bool:
    """Whether a sample is a publication of this version of the contract, or of no stated version; others are logged."""
    if sample.kind != zenoh.SampleKind.PUT:
        return False
    other = other_contract(str(sample.encoding))
    if other is not None:
        log.warning(
            "dropped a message key=%s contract=%s here=%s remedy=run_the_same_version_of_zarm_on_both_sides",
            sample.key_expr,
            other,
            CONTRACT,
        )
    return other is None


def deliver(key: str, payload: bytes, model: type[M], callback: Callable[[str, M], None]) -> None:
    """Call `callback` with the message received; log unreadable ones, and exceptions of the callback."""
    try:
        message = decode(model, payload)
    except InvalidRequest as error:
        _log_dropped(key, error)
        return
    try:
        callback(key, message)
    except Exception:  # whatever the callback does wrong, the next message must be delivered
        log.exception("subscriber failed key=%s", key)


def _log_dropped(key: str, error: InvalidRequest) -> None:
    log.warning("dropped a message key=%s reason=%s", key, error)
