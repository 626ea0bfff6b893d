"""Nothing is left behind in the executor by goals, cancels, switches of strategy, and clients that come and go."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from support.executor.client import Client
from support.harness import ServiceProcess, eventually
from support.resources import burden
from support.trajectories import HOME, KEYS, moved, rest_to_rest
from zarm_runtime.bus import Bus

pytestmark = pytest.mark.slow

THERE, BACK = rest_to_rest(moved(0.005)), rest_to_rest(HOME, moved(0.005))
GROWTH = 4 * 2**20
"""Bytes of memory that allocators and caches may take meanwhile; a leak of 16 kB a goal would be more."""


def test_goals_cancels_switches_and_clients_leave_nothing_behind(bus: Bus, endpoint: str, tmp_path: Path) -> None:
    with ServiceProcess("executor", endpoint, tmp_path) as executor:
        executor.wait_ready(bus, KEYS)
        client = Client(bus)

        def goals(count: int) -> None:
            for number in range(count):
                assert client.ended(client.execute(BACK if number % 2 else THERE)).status == "succeeded"

        def cancels(count: int) -> None:
            for _ in range(count):
                goal_id = client.execute(rest_to_rest(moved(1.0, start=client.position()), client.position()))
                client.cancel(goal_id)
                assert client.ended(goal_id).status == "cancelled"
                client.mode("idle")

        def switches(count: int) -> None:
            for number in range(count):
                name = "emulator" if number % 2 else "ghost"
                assert client.strategy(name).active == name

        def clients(count: int) -> None:
            for _ in range(count):
                with Bus(endpoint) as other:
                    joints = other.latest(KEYS.joint_states)
                    assert other.read(KEYS.executor_state, timeout=10).mode == "idle"
                    assert joints.wait(10) is not None

        def everything(part: Callable[[int], int]) -> None:
            goals(part(100))
            switches(part(100))
            clients(part(25))
            cancels(part(100))
            client.ended(client.execute(rest_to_rest(HOME, client.position())))

        everything(lambda count: count // 10)
        before = burden(executor)
        everything(lambda count: count)
        eventually(lambda: burden(executor).descriptors <= before.descriptors, "every connection is closed")
        after = burden(executor)
        print(f"executor before: {before}; after: {after}")  # noqa: T201
        assert after.threads <= before.threads + 2
        assert after.memory <= before.memory + GROWTH
        assert executor.output().count("level=WARNING") == 0
