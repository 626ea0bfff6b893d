"""The preview fails alone: the robot moves on, and the next plan is shown."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from support.executor.client import Client
from support.harness import ServiceProcess, eventually
from support.paths import PROGRAMS
from support.trajectories import KEYS, moved, plan, rest_to_rest
from zarm_contract.messages import Nothing
from zarm_runtime.bus import Bus

SCRIPT = str(PROGRAMS / "failing_preview.py")
BAD, GOOD = plan("plan-bad", rest_to_rest(moved(0.4))), plan("plan-good", rest_to_rest(moved(0.0, -0.3)))


def test_a_failing_preview_stops_nothing_and_shows_the_next_plan(bus: Bus, endpoint: str, tmp_path: Path) -> None:
    with ServiceProcess("executor", endpoint, tmp_path, script=SCRIPT) as executor:
        executor.wait_ready(bus, KEYS)
        client, shown = Client(bus), []
        bus.subscribe(KEYS.preview_joint_states, lambda _, joints: shown.append(joints.position))
        goal_id = client.execute(rest_to_rest(moved(0.5), slower=2.0))
        client.under_way(goal_id)
        plans = bus.publisher(KEYS.plans)
        plans.put(BAD)
        eventually(lambda: "ZeroDivisionError" in executor.output(), "the preview has failed")
        assert client.ended(goal_id).status == "succeeded"
        assert shown == []
        plans.put(GOOD)
        eventually(
            lambda: shown and np.allclose(shown[-1], GOOD.trajectory.position[-1]), "the next plan is shown to its end"
        )
        health = bus.call(KEYS.health("executor"), Nothing(), timeout=10)
        assert health.pid == executor.process.pid
        assert executor.output().count("Traceback") == 1
        assert client.state().problem is None
