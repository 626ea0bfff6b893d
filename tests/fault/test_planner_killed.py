"""What a client sees when the planner dies under its request."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import psutil
import pytest

from support.harness import ServiceProcess, eventually
from support.planner.client import BEHIND_FENCE, FENCE, HOME, KEYS, to_joints
from zarm_contract.errors import Unavailable
from zarm_contract.messages import (
    AddObjects,
    PlanRequest,
    SceneEdit,
)
from zarm_runtime.bus import Bus


def test_killing_the_planner_fails_its_request_at_once(endpoint: str, bus: Bus, tmp_path: Path) -> None:
    with ServiceProcess("planner", endpoint, tmp_path) as planner, ThreadPoolExecutor(1) as client:
        planner.wait_ready(bus, KEYS)
        bus.call(KEYS.scene_edit, SceneEdit(edit=AddObjects(op="add", objects=FENCE)), timeout=10)
        request = PlanRequest(goal=to_joints(*BEHIND_FENCE), start=HOME, timeout=60.0)
        with Bus(endpoint) as other:
            before = psutil.Process(planner.process.pid).cpu_times().user
            answer = client.submit(other.call, KEYS.plan, request, timeout=600.0)
            eventually(
                lambda: psutil.Process(planner.process.pid).cpu_times().user > before + 0.3, "the planner is searching"
            )
            assert not answer.done()
            planner.kill()
            with pytest.raises(Unavailable):
                answer.result(timeout=60)
