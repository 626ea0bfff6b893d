"""A ROS node in the process of the tests."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from typing import Any

import rclpy
from rclpy.context import Context
from rclpy.exceptions import InvalidHandle
from rclpy.executors import MultiThreadedExecutor, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.task import Future

from support.harness import PATIENCE, eventually
from zarm_ros_bridge.rclpy_parts import RCLError


@contextmanager
def running_node(name: str) -> Iterator[Node]:
    """A node of a separate participant, whose callbacks run one by one on their own thread, until the end."""
    with ExitStack() as stack:
        context = Context()
        rclpy.init(args=[], context=context)
        stack.callback(context.shutdown)
        node = Node(name, context=context)
        stack.callback(node.destroy_node)
        executor = SingleThreadedExecutor(context=context)
        executor.add_node(node)
        stack.callback(executor.shutdown)
        ended = Future()
        thread = threading.Thread(target=executor.spin_until_future_complete, args=(ended,), name=f"node {name}")
        thread.start()
        stack.callback(thread.join)
        stack.callback(ended.set_result, None)
        yield node


@contextmanager
def spinning(name: str) -> Iterator[Node]:
    """A node whose callbacks run on several threads, as pymoveit2 wants it."""
    context = Context()
    rclpy.init(args=[], context=context)
    node = Node(name, context=context)
    executor = MultiThreadedExecutor(2, context=context)
    executor.add_node(node)
    ended = threading.Event()

    def spin() -> None:
        while not ended.is_set():
            with suppress(InvalidHandle, RCLError):
                executor.spin()  # fails if a client destroys what the executor is about to wait for

    thread = threading.Thread(target=spin)
    thread.start()
    try:
        yield node
    finally:
        ended.set()
        executor.shutdown()
        thread.join()
        node.destroy_node()
        context.shutdown()


def on_its_thread(node: Node, ask: Callable[[], Future]) -> Future:
    """The result of `ask`, called on the callback thread: an ActionClient knows what it waits for only after it has
    asked.
    """
    return answer(node.executor.create_task(ask), "the node's thread has asked")


def served(node: Node, *actions: str) -> None:
    """Wait until these actions are known to a node, by what their servers publish: a client made to see it would have to be destroyed,
    which rclpy does not do while the node waits.
    """
    for action in actions:
        eventually(lambda action=action: node.count_publishers(f"{action}/_action/status"), f"{action} is served")


def destroyed(node: Node, destroy: Callable[[Any], object], part: Any) -> None:
    """Destroy a subscription or the like on the callback thread: rclpy fails a wait if it is destroyed concurrently."""
    answer(node.executor.create_task(destroy, part), "it is destroyed")


def answer(future: Future, what: str) -> Any:
    """The future's result; fails the test if there is none in time."""
    done = threading.Event()
    future.add_done_callback(lambda _: done.set())
    assert done.wait(PATIENCE), f"waited {PATIENCE:g} s in vain until {what}"
    return future.result()
