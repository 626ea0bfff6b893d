"""A wire between two hosts, in user space: two network devices, and a process that carries packets from one to the other.

Linux's own netem does the same for real devices, but many kernels come without it.
"""

from __future__ import annotations

import fcntl
import heapq
import itertools
import multiprocessing
import os
import random
import select
import struct
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection

from zarm_runtime.realtime import PROCESS_PRIORITY, ask_for_realtime

_TUNSETIFF = 0x400454CA
_IFF_TUN, _IFF_NO_PI = 0x0001, 0x1000
"""linux/if_tun.h"""
_LONGEST_PACKET = 65536


@dataclass(frozen=True)
class Quality:
    """What a wire does to packets: each is delayed by `delay` s, and lost with probability `loss`; a cut one loses all."""

    delay: float = 0.0
    loss: float = 0.0
    cut: bool = False


class Wire:
    """`ends` are the names of its two network devices."""

    def __init__(self, control: Connection) -> None:
        self._control = control
        self.ends: tuple[str, str] = control.recv()

    def become(self, quality: Quality) -> None:
        """Handle packets like this from now on; those on their way arrive."""
        self._control.send(quality)
        self._control.recv()


@contextmanager
def wire() -> Iterator[Wire]:
    """A wire, until the end of the block."""
    here, there = multiprocessing.Pipe()
    process = multiprocessing.get_context("spawn").Process(target=_carry, args=(there,))
    process.start()
    try:
        yield Wire(here)
    finally:
        process.terminate()
        process.join()
        process.close()
        here.close()
        there.close()


def _carry(control: Connection) -> None:
    ask_for_realtime(PROCESS_PRIORITY)  # the wire's quality alone must delay packets, not the machine's load
    devices = [_device(), _device()]
    control.send(tuple(name for _, name in devices))
    other = {devices[0][0]: devices[1][0], devices[1][0]: devices[0][0]}
    quality, order = Quality(), itertools.count()
    under_way: list[tuple[float, int, int, bytes]] = []
    while True:
        patience = max(0.0, under_way[0][0] - time.monotonic()) if under_way else None
        ready, _, _ = select.select([control, *other], [], [], patience)
        for source in ready:
            if source is control:
                quality = control.recv()
                control.send(quality)
                continue
            packet = os.read(source, _LONGEST_PACKET)
            if not quality.cut and random.random() >= quality.loss:
                heapq.heappush(under_way, (time.monotonic() + quality.delay, next(order), other[source], packet))
        while under_way and under_way[0][0] <= time.monotonic():
            _, _, end, packet = heapq.heappop(under_way)
            with suppress(OSError):  # a device that is down accepts nothing
                os.write(end, packet)


def _device() -> tuple[int, str]:
    """A file that reads packets sent through a new network device, and its name."""
    file = os.open("/dev/net/tun", os.O_RDWR)
    request = fcntl.ioctl(file, _TUNSETIFF, struct.pack("16sH22x", b"zarm%d", _IFF_TUN | _IFF_NO_PI))
    return file, request[:16].rstrip(b"\0").decode()
