"""The programs of examples/."""

from __future__ import annotations

import subprocess
import sys

from support.command_line import environment
from support.harness import PATIENCE
from support.paths import ROOT

EXAMPLES = ROOT / "examples"


def run_example(name: str, endpoint: str, timeout: float = PATIENCE) -> str:
    """What an example prints on the bus of the router at `endpoint`; it must succeed, and say nothing besides."""
    done = subprocess.run(
        [sys.executable, str(EXAMPLES / f"{name}.py")],
        env=environment(ZARM_CONNECT=endpoint),
        capture_output=True,
        text=True,
        timeout=timeout,
    )
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    return done.stdout
