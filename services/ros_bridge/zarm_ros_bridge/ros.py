"""One participant on ROS: a context, its nodes, and the threads that serve them."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from types import TracebackType
from typing import Any, Self

import rclpy
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.context import Context
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

from zarm_ros_bridge.leader_followers import LeaderFollowersExecutor
from zarm_ros_bridge.rclpy_parts import CheckedParameterService, Reception
from zarm_ros_bridge.replies import Unanswered
from zarm_runtime import dds

log = logging.getLogger(__name__)

REQUESTS = QoSProfile(
    history=HistoryPolicy.KEEP_LAST,
    depth=1000,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.VOLATILE,
)
"""Requests that may wait for a service. The default of ROS is 10 for all clients together: further ones are lost, and
their clients wait for ever.
"""
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
"""Late subscribers receive the last message."""


class Ros:
    """The node `name` under `namespace`, in a context of its own, served by `workers` threads from `spin` on.

    With `parameters` it has the parameter services, and logs to /rosout. Other nodes have names that begin with `_`, so
    that tools skip them: `ros2 param list` waits for each node that it sees.

    Use it in `with`. Services and actions of `node` in `group` may wait, each in its own thread. High-rate topics go to
    `listen`: a second node, for these alone, with its own thread, whose callbacks must return quickly. DDS refuses two
    types under one name in one participant; a second `Ros` is a second participant. `zarm_runtime.dds` decides whom it
    reaches.
    """

    def __init__(self, name: str, namespace: str = "", *, workers: int, parameters: bool = False) -> None:
        dds.join()
        self._context = Context()
        rclpy.init(args=[], context=self._context)
        self.node = self._node(name, namespace, parameters=parameters)
        self.group = ReentrantCallbackGroup()
        self._listener = self._node(f"_{name.lstrip('_')}_listener", namespace, parameters=False)
        self._executor = LeaderFollowersExecutor(self._context)
        self._reception = Reception(self._listener)
        self._listening = threading.Thread(target=_run, args=(self._reception.run,), name=f"ros {name}_listener")
        self._workers = [
            threading.Thread(target=_run, args=(self._executor.spin,), name=f"ros {name}")
            for _ in range(workers + 1)  # one of which waits
        ]

    def serve(self, kind: type[Any], name: str, answer: Callable[[Any, Any], Any]) -> None:
        """The service `name`: `answer(request, response)` returns the response, and may wait. Call before `spin`."""
        self.node.create_service(kind, name, answer, qos_profile=REQUESTS, callback_group=self.group)

    def listen(
        self,
        kind: type[Any],
        topic: str,
        callback: Callable[[Any], float | None],
        qos: QoSProfile | int,
        *,
        raw: bool = False,
    ) -> None:
        """Call `callback(message)` for each message on `topic`, as bytes if `raw`, one at a time. Call before `spin`.

        If it returns a number of seconds, and nothing else arrives, messages on any of these topics may wait that long,
        or until `hurry`.
        """
        self._listener.create_subscription(kind, topic, callback, qos, raw=raw)

    def hurry(self) -> None:
        """Messages to listeners must not wait any more."""
        self._reception.hurry()

    def run(self, work: Callable[[], None]) -> None:
        """Do some work in one of the threads that serve, soon."""
        self._executor.create_task(work)

    def spin(self) -> None:
        """Serve from now on."""
        self._executor.add_node(self.node)
        for thread in (self._listening, *self._workers):
            thread.start()

    def stop_listening(self) -> None:
        """Call no callback of `listen` any more, once the current one has returned."""
        self._reception.end()
        if self._listening.is_alive():
            self._listening.join()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop_listening()
        self._executor.shutdown()
        for thread in self._workers:
            if thread.is_alive():
                thread.join()
        for node in (self.node, self._listener):
            node.destroy_node()
        self._context.shutdown()

    def _node(self, name: str, namespace: str, *, parameters: bool) -> Node:
        node = Node(
            name,
            namespace=namespace,
            context=self._context,
            use_global_arguments=False,
            start_parameter_services=False,
            parameter_overrides=[Parameter("start_type_description_service", value=parameters)],
            enable_rosout=parameters,
        )
        if parameters:
            CheckedParameterService(node)  # kept alive by the node
        return node


def _run(work: Callable[[], None]) -> None:
    """Repeat until it returns: rclpy ends at the first callback that raises, and the node would then be deaf."""
    while True:
        try:
            work()
        except Unanswered as error:
            log.warning("unanswered reason=%s", error)
        except Exception:
            log.exception("a callback of ROS failed")
        else:
            return
