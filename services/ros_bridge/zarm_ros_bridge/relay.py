"""Relays a key of the bus to ROS topics while they have subscribers."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from typing import Any, Generic, TypeVar

from rclpy.event_handler import PublisherEventCallbacks
from rclpy.node import Node

from zarm_contract.messages import Message
from zarm_runtime.bus import Bus
from zarm_runtime.publications import deliver

DEPTH = 10

M = TypeVar("M", bound=Message)


class Relay(Generic[M]):
    """Publishes the messages on `key`, converted by `convert`, on each of `topics` that has subscribers and whose
    condition holds.

    Without subscribers the key is not received, since joints come at a high rate. Close it before the bus.
    """

    def __init__(
        self,
        node: Node,
        bus: Bus,
        key: str,
        model: type[M],
        kind: type[Any],
        convert: Callable[[M], Any],
        topics: Mapping[str, Callable[[], bool]],
    ) -> None:
        self._bus, self._key, self._model, self._convert = bus, key, model, convert
        self._turn = threading.Lock()
        self._closed = False
        self._end: Callable[[], None] | None = None
        events = PublisherEventCallbacks(matched=lambda _: self._follow())
        self._publishers = {
            node.create_publisher(kind, topic, DEPTH, event_callbacks=events): holds for topic, holds in topics.items()
        }

    def close(self) -> None:
        """Stop receiving."""
        self._closed = True
        self._follow()

    def _follow(self) -> None:
        with self._turn:
            subscribed = any(publisher.get_subscription_count() for publisher in self._publishers) and not self._closed
            if subscribed and self._end is None:
                self._end = self._bus.listen(self._key, self._receive)
            elif not subscribed and self._end is not None:
                self._end()
                self._end = None

    def _receive(self, key: str, payload: bytes) -> None:
        publishers = [
            publisher for publisher, holds in self._publishers.items() if holds() and publisher.get_subscription_count()
        ]
        if publishers:
            deliver(key, payload, self._model, lambda _, message: self._publish(message, publishers))

    def _publish(self, message: M, publishers: list[Any]) -> None:
        converted = self._convert(message)
        for publisher in publishers:
            publisher.publish(converted)
