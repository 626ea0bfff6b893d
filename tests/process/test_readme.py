"""The zenoh lines of the README, run as they stand."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

from support.harness import ServiceProcess
from support.markdown import section, shell_blocks
from support.paths import ROOT
from zarm_contract.keys import Keys
from zarm_runtime.bus import Bus

README = ROOT / "README.md"
KEYS = Keys("doosan_m1013")


def test_the_zenoh_lines_of_the_readme_work_as_written(endpoint: str, bus: Bus, tmp_path: Path) -> None:
    (lines,) = shell_blocks(section(README.read_text(), "With the zenoh command line"))
    with (
        ServiceProcess("planner", endpoint, tmp_path) as planner,
        ServiceProcess("executor", endpoint, tmp_path) as executor,
    ):
        executor.wait_ready(bus, KEYS)
        planner.wait_ready(bus, KEYS)
        environment = os.environ | {
            "ZARM_CONNECT": endpoint,
            "PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}",
        }
        done = subprocess.run(["bash", "-c", lines], env=environment, capture_output=True, text=True, timeout=60)
    state, scene, plan, accepted, goal, *joints = (json.loads(line) for line in done.stdout.splitlines())
    assert done.stderr == ""
    assert state["mode"] == "idle"
    assert scene["objects"] == []
    assert plan["trajectory"]["joint_names"] == [f"joint_{k}" for k in range(1, 7)]
    assert goal["goal_id"] == accepted["goal_id"]
    assert goal["plan_id"] == plan["plan_id"]
    assert goal["status"] in ("accepted", "running", "succeeded")
    assert len(joints) > 10
    assert all(len(state["position"]) == 6 for state in joints)
