"""The kernels can be compiled before any planner starts."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

from support.harness import PATIENCE, nothing_compiled
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


def test_ctrl_c_ends_the_compilation_without_a_traceback(tmp_path: Path) -> None:
    with subprocess.Popen(
        [sys.executable, "-m", "zarm_planner.warm_up"],
        env=os.environ | nothing_compiled(tmp_path),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline().endswith(f"(1 of {STAGES})\n")
        process.send_signal(signal.SIGINT)
        output, errors = process.communicate(timeout=PATIENCE)
    assert process.returncode == -signal.SIGINT
    assert f"({STAGES} of {STAGES})" not in output
    assert errors == ""


def test_after_warm_up_no_plan_waits_for_a_compiler() -> None:
    script = PROGRAMS / "warm_kernels.py"
    done = subprocess.run([sys.executable, str(script)], capture_output=True, text=True, check=True)
    assert done.stdout == ""
