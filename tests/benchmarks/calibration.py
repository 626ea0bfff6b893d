"""How often a client that knows no faults takes a robot through all poses of a calibration on a busy machine.

    python tests/benchmarks/calibration.py [--runs 20] [--busy 5] [--strategies joint_speed joint_trajectory]

Each run starts all of zarm anew, with a driver on ROS, beside processes that never rest. Of one that fails it says at which
pose, and why, and keeps the logs.
"""

from __future__ import annotations

import argparse
import os
import shutil
import sys
import tempfile
import time
from pathlib import Path

from rich.console import Console

sys.path.insert(0, str(Path(__file__).parents[1]))
from support.ros.calibration import POSES, calibrate
from support.ros.domain import isolate


def main() -> None:
    """Run all of it, and say what came of each run."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--runs", type=int, default=20)
    parser.add_argument("--busy", type=int, default=5, help="how many processes never rest")
    parser.add_argument("--strategies", nargs="+", default=["joint_speed", "joint_trajectory"])
    options = parser.parse_args()
    isolate()
    out = Console(highlight=False, soft_wrap=True)
    whole = dict.fromkeys(options.strategies, 0)
    for index in range(1, options.runs + 1):
        for strategy in options.strategies:
            folder, began = Path(tempfile.mkdtemp()), time.monotonic()
            why = calibrate(folder, strategy, busy=options.busy, seed=index)
            took, load = time.monotonic() - began, os.getloadavg()[0]
            said = f"{why} (logs in {folder})" if why else f"{POSES} poses"
            out.print(f"{strategy}, run {index}, {took:.0f} s, load {load:.1f}: {said}")
            if not why:
                whole[strategy] += 1
                shutil.rmtree(folder)
    for strategy, count in whole.items():
        out.print(f"{strategy}: {POSES} of {POSES} poses in {count} of {options.runs} runs")


if __name__ == "__main__":
    main()
