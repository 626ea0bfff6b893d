"""The bridge is replaced while the robot moves and clients on ROS ask."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path

import pytest
from std_srvs.srv import Trigger

from support.executor.client import Client
from support.harness import PATIENCE, ServiceProcess, eventually
from support.ros.stack import KEYS, stack
from support.trajectories import moved, rest_to_rest

pytestmark = pytest.mark.slow

SLOW = rest_to_rest(moved(0.8), slower=6.0)


def test_a_bridge_is_replaced_while_the_robot_moves(tmp_path: Path) -> None:
    with ExitStack() as later, stack(tmp_path) as zarm:
        client = Client(zarm.bus, KEYS)
        ask = lambda: zarm.ros.call(Trigger, "get_robot_strategy").message  # noqa: E731
        before = ask()
        goal = client.execute(SLOW)
        client.under_way(goal, 0.05)
        old = zarm.processes["ros_bridge"]
        old.process.terminate()
        assert old.process.wait(PATIENCE) == 0
        assert "Traceback" not in old.output()
        new = later.enter_context(ServiceProcess("ros_bridge", old.endpoint, tmp_path, name=KEYS.robot))
        zarm.processes["ros_bridge"] = new
        new.wait_ready(zarm.bus, KEYS)
        assert ask() == before
        assert client.ended(goal).status == "succeeded"
        eventually(lambda: client.statuses(goal) == ["accepted", "running", "succeeded"], "all of it is told")
