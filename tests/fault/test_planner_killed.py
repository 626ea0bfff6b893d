"""What a client sees when the planner dies under its request."""

from __future__ import annotations

import math
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import psutil
import pytest

from support.harness import ServiceProcess, eventually
from zarm_contract.errors import Unavailable
from zarm_contract.keys import Keys
from zarm_contract.messages import (
    AddObjects,
    Cuboid,
    JointGoal,
    Plan,
    PlanRequest,
    SceneEdit,
    SceneEdited,
)
from zarm_runtime.bus import Bus

KEYS = Keys("doosan_m1013")
HOME = (0.0, 0.0, 1.5708, 0.0, 1.5708, 0.0)
BEHIND_WALL = (3.1416, *HOME[1:])
TURN = (0.0, 0.0, math.sin(0.375 * math.pi), math.cos(0.375 * math.pi))
WALL = Cuboid(kind="cuboid", name="wall", position=(-1.23, 1.23, 0.3), orientation=TURN, size=(3.0, 0.05, 1.6))
LID = Cuboid(kind="cuboid", name="lid", position=(0.0, 0.0, 1.1), size=(6.0, 6.0, 0.05))
"""Together they leave no way for the arm to turn round, so the search goes on until its deadline."""


def test_a_client_whose_planner_is_killed_during_its_plan_gets_unavailable_long_before_its_timeout(
    endpoint: str, bus: Bus, tmp_path: Path
) -> None:
    with ServiceProcess("planner", endpoint, tmp_path) as planner, ThreadPoolExecutor(1) as client:
        planner.wait_ready(bus, KEYS)
        bus.call(KEYS.scene_edit, SceneEdit(edit=AddObjects(op="add", objects=(WALL, LID))), SceneEdited, timeout=10)
        request = PlanRequest(goal=JointGoal(kind="joints", position=BEHIND_WALL), start=HOME, timeout=60.0)
        with Bus(endpoint) as other:
            before = psutil.Process(planner.process.pid).cpu_times().user
            answer = client.submit(other.call, KEYS.plan, request, Plan, timeout=600.0)
            eventually(
                lambda: psutil.Process(planner.process.pid).cpu_times().user > before + 0.3, "the planner is searching"
            )
            assert not answer.done()
            planner.kill()
            with pytest.raises(Unavailable):
                answer.result(timeout=60)
