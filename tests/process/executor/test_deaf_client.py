"""A client that takes nothing off its link any more holds up neither the robot nor a stop."""

from __future__ import annotations

import itertools
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from support.executor.client import Client
from support.harness import PATIENCE, ServiceProcess, eventually, free_endpoint
from support.network.deaf import beside, deaf_client, route
from support.trajectories import KEYS, moved, rest_to_rest
from zarm_runtime.bus import Bus

FAR = rest_to_rest(moved(1.0, -0.5, 0.3), slower=4.0)


def test_a_deaf_client_delays_neither_motion_nor_stop(tmp_path: Path) -> None:
    endpoint = free_endpoint()
    with (
        beside(route, endpoint),
        Bus(endpoint, timeout=PATIENCE) as bus,
        ServiceProcess("executor", endpoint, tmp_path) as executor,
        ThreadPoolExecutor(1) as pool,
    ):
        executor.wait_ready(bus, KEYS)
        client = Client(bus)
        with deaf_client(endpoint) as turn_deaf:
            goal_id = client.execute(FAR)
            client.under_way(goal_id, 0.1)
            turn_deaf()
            seen = len(client.measured)
            eventually(lambda: len(client.measured) > seen + 30, "the joints are told")
            here = [state.position for state in client.measured[seen:]]
            assert all(before != after for before, after in itertools.pairwise(here))
            answer = pool.submit(client.command, KEYS.stop)
            eventually(lambda: not any(client.measured[-1].velocity), "the robot is at rest")
            assert client.measured[-1].position != FAR.position[-1]
            assert not answer.done()  # what is told waits for the client
        assert answer.result().mode in ("stopping", "idle")
        assert client.ended(goal_id).status == "cancelled"
        reported = ["accepted", "running", "stopping", "cancelled"]
        eventually(lambda: client.statuses(goal_id) == reported, "all of it is told")
        assert client.greatest_acceleration() <= 1.05
