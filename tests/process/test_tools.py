"""A tool that is mounted while planner, executor and servo run is the tip for all of them."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import zarm
from support.command_line import zarm as run_zarm
from support.harness import ServiceProcess, router
from support.tools import tooled_robot, with_tools
from zarm_contract.keys import Keys
from zarm_geometry.frames import matrix
from zarm_geometry.robot_model import RobotModel
from zarm_runtime.bus import Bus

KEYS = Keys("doosan_m1013")
TIP = matrix((0.05, 0.0, 0.25), (0.0, 0.7071067811865476, 0.0, 0.7071067811865476))


def test_a_mounted_tool_is_tracked_and_fixed_during_motion(tmp_path: Path) -> None:
    path = with_tools(tmp_path)
    model = RobotModel.of(tooled_robot(tmp_path))

    def tip(q: tuple[float, ...]) -> np.ndarray:
        return model.fk_link("link_6", np.array(q)) @ TIP

    with (
        router() as endpoint,
        Bus(endpoint) as bus,
        ServiceProcess("planner", endpoint, tmp_path, path) as planner,
        ServiceProcess("executor", endpoint, tmp_path, path) as executor,
        ServiceProcess("servo", endpoint, tmp_path, path) as servo,
    ):
        for process in (planner, executor, servo):
            process.wait_ready(bus, KEYS)
        with zarm.connect(endpoint) as robot:
            earlier = robot.plan((0.3, *robot.joint_state().position[1:]))
            done = run_zarm("tool", "mount", "welder", ZARM_CONNECT=endpoint)
            assert done.returncode == 0, done.stderr
            listed = run_zarm("tool", "list", "--json", ZARM_CONNECT=endpoint)
            assert json.loads(listed.stdout) == {"tools": [{"name": "welder", "link": "link_6"}]}
            with pytest.raises(zarm.ExecutionRefused) as refused:
                robot.execute(earlier)
            assert refused.value.code == "stale_plan", "it was checked without the tool"
            home = robot.tip()
            assert home.position == pytest.approx(tip(robot.joint_state().position)[:3, 3], abs=1e-6)

            x, y, z = home.position
            away = zarm.Pose((x, y + 0.15, z - 0.05), home.orientation)
            running = robot.start(robot.plan(away, velocity_scale=0.3))
            with pytest.raises(zarm.Busy, match="the robot is in motion"):
                robot.scene.mount("probe")
            assert robot.follow(running).status == "succeeded"
            assert tip(robot.joint_state().position)[:3, 3] == pytest.approx(away.position, abs=2e-3)

            with robot.track() as tracking:
                with pytest.raises(zarm.Busy, match="the robot is in motion"):
                    robot.scene.unmount("welder")
                tracking.reach(home, timeout=30.0)
            assert tip(robot.joint_state().position)[:3, 3] == pytest.approx(home.position, abs=5e-3)

            assert robot.scene.unmount("welder").count == 0
            assert robot.tip().position == pytest.approx(
                model.fk_link("link_6", np.array(robot.joint_state().position))[:3, 3], abs=1e-6
            )
