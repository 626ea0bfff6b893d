"""The kernels can be compiled before any planner starts."""

from __future__ import annotations

import subprocess
import sys

from support.paths import PROGRAMS
from zarm_planner.warm_up import STAGES


def test_warming_up_says_each_stage_in_a_line() -> None:
    done = subprocess.run([sys.executable, "-m", "zarm_planner.warm_up"], capture_output=True, text=True, check=True)
    stages = done.stdout.splitlines()
    assert len(stages) == len(set(stages)) == STAGES
    for number, stage in enumerate(stages, start=1):
        assert stage.startswith("loading ")
        assert stage.endswith(f"({number} of {STAGES})")
    assert done.stderr == ""


def test_after_the_warm_up_of_one_robot_no_plan_of_any_robot_waits_for_a_compiler() -> None:
    script = PROGRAMS / "warm_kernels.py"
    done = subprocess.run([sys.executable, str(script)], capture_output=True, text=True, check=True)
    assert done.stdout == ""
