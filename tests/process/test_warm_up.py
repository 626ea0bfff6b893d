"""The kernels can be compiled before any planner starts."""

from __future__ import annotations

import subprocess
import sys


def test_warming_up_says_each_stage_in_a_line() -> None:
    done = subprocess.run([sys.executable, "-m", "zarm_planner.warm_up"], capture_output=True, text=True, check=True)
    stages = done.stdout.splitlines()
    assert len(stages) == len(set(stages)) > 1
    assert all(stage.startswith("loading ") for stage in stages)
    assert done.stderr == ""
