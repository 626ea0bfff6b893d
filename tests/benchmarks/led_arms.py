"""How far two arms with an executor each are apart on their paths: `python tests/benchmarks/led_arms.py [--motions 30]`.

Two emulated Pandas, and a third executor that leads both, all as processes on this machine. Of random motions of both, the
time on the path is compared that each arm has reached at the same moment, by the joints that it measures and their stamps.
Every second motion is paused on its way, and goes on.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from contextlib import ExitStack
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np
from rich.console import Console

import zarm
from support.led_cell import ARMS, LedCell
from zarm_contract.errors import PlanningFailed
from zarm_contract.messages import GoalState


def main() -> None:
    """Print one line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--motions", type=int, default=30)
    count = parser.parse_args().motions
    rng = np.random.default_rng(0)
    apart: list[float] = []
    off = 0.0
    with ExitStack() as stack:
        cell = LedCell(stack, Path(stack.enter_context(tempfile.TemporaryDirectory())))
        home = np.array(cell.robot.descriptor.home)
        done = 0
        while done < count:
            try:
                plan = cell.whole.plan(home + rng.uniform(-0.6, 0.6, len(home)), optimize_s=0.0)
            except PlanningFailed:
                continue
            for name in ARMS:
                cell.seen[name].clear()
            if done % 2:
                cell.whole.execute(plan, on_progress=Pause(cell.whole))
            else:
                cell.whole.execute(plan)
            apart.append(float(np.abs(cell.apart(plan)).max()))
            off = max(off, *cell.off_path(plan).values())
            done += 1
    Console(width=120).print(
        f"{count} motions: the arms were apart by {1e3 * np.median(apart):.1f} ms at most (median; 95 %: "
        f"{1e3 * np.percentile(apart, 95):.1f} ms, greatest {1e3 * max(apart):.1f} ms), and {off:.5f} rad off their paths"
    )


class Pause:
    """Stops a goal once on its way, and lets it go on."""

    def __init__(self, robot: zarm.Robot) -> None:
        self._robot, self._paused = robot, False

    def __call__(self, goal: GoalState) -> None:
        if goal.status == "running" and goal.progress > 0.2 and not self._paused:
            self._paused = True
            self._robot.pause()
        elif goal.status == "paused":
            self._robot.resume()


if __name__ == "__main__":
    main()
