"""However many payloads come that are as large as is read, the memory of the executor stays below what its README says."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from itertools import product
from pathlib import Path

import pytest
import zenoh

from support.faults import payloads
from support.harness import PATIENCE, ServiceProcess
from support.resources import burden
from support.trajectories import KEYS
from zarm_runtime.bus import Bus
from zarm_runtime.session import open_client

pytestmark = pytest.mark.slow

BOUND = 320 * 2**20
"""Bytes of memory that the executor has at most."""
GROWTH = 64 * 2**20
"""How much larger, in bytes, the executor may be after as many again: what is still on its way through it, 16 messages of 8 MB."""
ROUNDS = 5
"""So many times everything fills the record of the last minute, 64 MiB."""
CLIENTS = 16

PUBLISHED = (KEYS.plans, KEYS.stream, KEYS.scene_revision, KEYS.driver_joint_states, KEYS.driver_progress)
ASKED = (KEYS.execute, KEYS.cancel, KEYS.strategy, KEYS.speed, KEYS.stop, KEYS.health("executor"), KEYS.executor_state)


def shout(session: zenoh.Session, key: str, payload: bytes) -> None:
    block = zenoh.CongestionControl.BLOCK
    if key in PUBLISHED:
        session.put(key, payload, congestion_control=block)
    else:
        assert len(list(session.get(key, payload=payload, timeout=PATIENCE, congestion_control=block))) == 1


@pytest.mark.timeout(300)
def test_large_payloads_leave_nothing_behind(bus: Bus, endpoint: str, tmp_path: Path) -> None:
    with (
        ServiceProcess("executor", endpoint, tmp_path) as executor,
        open_client(endpoint) as session,
        ThreadPoolExecutor(CLIENTS) as pool,
    ):
        executor.wait_ready(bus, KEYS)
        everything = list(product((*PUBLISHED, *ASKED), payloads.ENORMOUS)) * ROUNDS
        taken = []
        for _ in range(2):
            list(pool.map(lambda one: shout(session, *one), everything))
            taken.append(burden(executor).memory)
        print("executor: MiB", [round(one / 2**20) for one in taken])  # noqa: T201
        assert max(taken) <= BOUND
        assert taken[1] <= taken[0] + GROWTH
