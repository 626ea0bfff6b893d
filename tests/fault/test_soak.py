"""Hour after hour: plans executed back to back at 250 Hz, every one succeeds, and nothing grows.

`ZARM_SOAK_SECONDS` is for how long.
"""

from __future__ import annotations

import os
import time
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import pytest

from support.executor.client import Client
from support.harness import ServiceProcess
from support.resources import Burden, burden, favour
from support.trajectories import KEYS, ROBOT, moved
from zarm_contract.messages import JointGoal, PlanRequest
from zarm_contract.robot import ROBOTS
from zarm_runtime.bus import Bus

pytestmark = pytest.mark.slow

SECONDS = float(os.environ.get("ZARM_SOAK_SECONDS", "20"))
RATE = 250
PATIENT = 0.5
"""s without joint states; a crowded machine may keep the driver waiting, and how soon silence is noticed is tested elsewhere."""
PLACES = [
    JointGoal(kind="joints", position=tuple(moved(*by).tolist())) for by in ((0.6, -0.3), (-0.4, 0.2, 0.3), (0.2,))
]
GROWTH = {"planner": 24, "executor": 6, "leeloo_sim": 6}
"""By how many MiB the straight line through a service's memory may rise over the soak, its first third left out."""


def fast_robot(folder: Path) -> str:
    """The descriptor of the robot with a control loop at 250 Hz."""
    name = ROBOT.descriptor.name
    for file in (f"{name}.yaml", f"{name}.urdf"):
        (folder / file).write_bytes((ROBOTS / file).read_bytes())
    with (folder / f"{name}.yaml").open("a") as descriptor:
        descriptor.write(f"\nexecution:\n  control_rate: {RATE}\n  joint_state_timeout: {PATIENT}\n")
    return str(folder / f"{name}.yaml")


@pytest.mark.timeout(120 + 2 * SECONDS)
def test_plans_are_executed_back_to_back_and_nothing_grows(bus: Bus, endpoint: str, tmp_path: Path) -> None:
    with ExitStack() as stack:
        robot = fast_robot(tmp_path)
        services = [
            ServiceProcess("leeloo_sim", endpoint, tmp_path, robot),
            ServiceProcess("planner", endpoint, tmp_path, robot),
            ServiceProcess("executor", endpoint, tmp_path, robot, arguments=("--strategy", "joint_speed")),
        ]
        for service in services:
            stack.enter_context(service).wait_ready(bus, KEYS)
        favour(services[0], services[2])
        client, goals, taken = Client(bus), 0, []
        began = time.monotonic()
        while time.monotonic() < began + SECONDS or goals < 3:
            request = PlanRequest(goal=PLACES[goals % len(PLACES)])
            plan = bus.call(KEYS.plan, request, timeout=60)
            end = client.ended(client.execute(plan_id=plan.plan_id))
            assert end.status == "succeeded", (goals, end)
            np.testing.assert_allclose(client.position(), plan.trajectory.position[-1], atol=0.005)
            goals += 1
            taken.append((time.monotonic() - began, [burden(service) for service in services]))
            for reported in (client.measured, client.goals, client.states):
                reported.clear()
        state = client.state()
        assert state.mode == "idle"
        assert state.problem is None
        print(f"\n{goals} goals in {taken[-1][0]:.0f} s, {state.missed_ticks} ticks missed")  # noqa: T201
        for place, service in enumerate(services):
            assert service.process.poll() is None
            hold_flat(service, [(at, burdens[place]) for at, burdens in taken[len(taken) // 3 :]])


def hold_flat(service: ServiceProcess, taken: list[tuple[float, Burden]]) -> None:
    """Fails where a service has grown: its memory by the straight line through all of it, the rest from first to last."""
    times = np.array([at for at, _ in taken])
    memory = np.array([one.memory / 2**20 for _, one in taken])
    rise = float(np.polyfit(times, memory, 1)[0]) * (times[-1] - times[0]) if len(taken) > 2 else 0.0
    first, last = taken[0][1], taken[-1][1]
    print(f"{service.service}: {first}; {last}; {rise:+.2f} MiB, log {len(service.output())} bytes")  # noqa: T201
    assert rise <= GROWTH[service.service]
    assert last.threads <= first.threads + 2
    assert last.descriptors <= first.descriptors + 2
