"""A client that stops reading its link, and a router that has patience with it, each as a process."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from multiprocessing.sharedctypes import Synchronized

import zenoh

from support.harness import PATIENCE, eventually
from zarm_runtime.session import open_client, router_config, run_router

SPAWN = multiprocessing.get_context("spawn")


def route(endpoint: str) -> None:
    """A router that waits for a blocked client, while zarm's own gives up its link after a second."""
    config = router_config(endpoint)
    config.insert_json5("transport/link/tx/queue/congestion_control/block/wait_before_close", str(int(PATIENCE * 1e6)))
    with run_router(config):
        threading.Event().wait()


def receive(endpoint: str, heard: Synchronized[int]) -> None:
    """A client that subscribes to everything."""

    def count(_: zenoh.Sample) -> None:
        heard.value += 1

    with open_client(endpoint) as session:
        session.declare_subscriber("**", count)
        threading.Event().wait()


def flood(endpoint: str, published: Synchronized[int]) -> None:
    """A client that publishes without end, as much as there is room for."""
    with open_client(endpoint) as session:
        while True:
            session.put("flood", bytes(100_000), congestion_control=zenoh.CongestionControl.BLOCK)
            published.value += 1


@contextmanager
def beside(work: Callable[..., None], *arguments: object) -> Iterator[int]:
    """A process that does this until the end of the block; yields its id."""
    process = SPAWN.Process(target=work, args=arguments)
    process.start()
    try:
        yield process.pid or 0
    finally:
        process.kill()
        process.join()


@contextmanager
def deaf_client(endpoint: str) -> Iterator[Callable[[], None]]:
    """A client that receives something first; after calling what is yielded, it reads nothing until the end, with its
    link full.
    """
    heard, published = SPAWN.Value("q", 0), SPAWN.Value("q", 0)
    with ExitStack() as stack:
        pid = stack.enter_context(beside(receive, endpoint, heard))
        eventually(lambda: heard.value > 0, "the client hears what is published")

        def turn_deaf() -> None:
            os.kill(pid, signal.SIGSTOP)
            stack.callback(os.kill, pid, signal.SIGCONT)
            stack.enter_context(beside(flood, endpoint, published))
            eventually(lambda: published.value > 0, "the flood has begun")
            before = 0
            while published.value > before:
                before = published.value
                time.sleep(0.2)

        yield turn_deaf
