"""A robot's file that is changed while its services run: taken on request, and never while the robot moves."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from support.harness import PATIENCE, ServiceProcess, eventually
from zarm_contract.errors import Busy, Unavailable
from zarm_contract.keys import Keys
from zarm_contract.messages import (
    CancelRequest,
    ExecuteRequest,
    Health,
    JointGoal,
    Nothing,
    Plan,
    PlanRequest,
)
from zarm_contract.robot import ROBOTS, load_robot
from zarm_runtime.bus import Bus

KEYS = Keys("doosan_m1013")
HOME = load_robot("doosan_m1013").descriptor.home
SPEEDS = "velocity: [1.2, 1.2, 1.2, 1.2, 1.2, 1.2]"


def test_changed_limits_apply_to_new_plans_and_motions(endpoint: str, bus: Bus, tmp_path: Path) -> None:
    for name in ("doosan_m1013.yaml", "doosan_m1013.urdf"):
        (tmp_path / name).write_bytes((ROBOTS / name).read_bytes())
    file = tmp_path / "doosan_m1013.yaml"

    def reread(service: str) -> Health:
        return bus.call(KEYS.reread(service), Nothing(), timeout=PATIENCE)

    def plan() -> Plan:
        request = PlanRequest(goal=JointGoal(kind="joints", position=(1.0, *HOME[1:])))
        return bus.call(KEYS.plan, request, timeout=PATIENCE)

    def execute() -> str:
        return bus.call(KEYS.execute, ExecuteRequest(), timeout=PATIENCE).goal_id

    def taken(service: str) -> bool:
        try:
            health = bus.call(KEYS.health(service), Nothing(), timeout=PATIENCE)
        except Unavailable:
            return False
        return health.ready and health.robot_hash == load_robot(str(file)).hash

    with (
        ServiceProcess("planner", endpoint, tmp_path, robot=str(file)) as planner,
        ServiceProcess("executor", endpoint, tmp_path, robot=str(file)) as executor,
    ):
        for process in (planner, executor):
            process.wait_ready(bus, KEYS)
        plan()
        goal = execute()
        file.write_text(file.read_text().replace(SPEEDS, SPEEDS.replace("1.2", "0.2")))
        with pytest.raises(Busy, match="running"):
            reread("executor")
        bus.call(KEYS.cancel, CancelRequest(goal_id=goal), timeout=PATIENCE)
        eventually(lambda: bus.read(KEYS.executor_state, timeout=PATIENCE).mode == "idle", "it rests")
        for service in ("planner", "executor"):
            reread(service)
            eventually(lambda service=service: taken(service), f"the {service} has taken the file")
        slow = plan()
        assert np.abs(slow.trajectory.velocity).max() <= 0.2 * 1.001
        assert execute()
        assert (planner.process.poll(), executor.process.poll()) == (None, None)
