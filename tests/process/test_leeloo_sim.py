"""The simulated driver says what keeps it from ROS."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

WITHOUT_ROS = "import sys; sys.modules['rclpy'] = None; from zarm_leeloo_sim.service import main; sys.exit(main())"


@pytest.mark.parametrize(
    ("robot", "words"),
    [("doosan_m1013", "`make ros` installs it"), ("panda", "write strategy_params into its descriptor")],
)
def test_it_refuses_ros_that_it_cannot_speak(robot: str, words: str, endpoint: str, tmp_path: Path) -> None:
    command = [sys.executable, "-c", WITHOUT_ROS, "--robot", robot, "--connect", endpoint, "--state", str(tmp_path)]
    done = subprocess.run([*command, "--ros"], stderr=subprocess.PIPE, text=True, timeout=60)
    assert done.returncode == 1
    assert words in done.stderr.splitlines()[-1]
