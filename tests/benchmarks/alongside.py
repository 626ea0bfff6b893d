"""One arm planned while the other moves: `python tests/benchmarks/alongside.py [--cases 2500] [--seed 2]`.

Two Pandas, 0.6 m apart. The left one is on its way to a random goal, planned at a random speed; at a random moment the right one is asked to go to a random goal
of its own. Each motion of both is looked at every millisecond: limits, exact distances of all links, and whether the left arm does what it would have done.
"""

from __future__ import annotations

import argparse
import logging
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

from zarm_trajectory.arrays import Array

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

from support.composed import two_pandas
from zarm_contract.errors import ZarmError
from zarm_contract.messages import JointGoal, PlanRequest
from zarm_contract.robot import load_robot
from zarm_geometry.exact import ExactScene
from zarm_geometry.robot_model import RobotModel
from zarm_geometry.world import World
from zarm_planner.handlers import Handlers
from zarm_planner.scene.store import SceneStore
from zarm_trajectory.limits import Limits
from zarm_trajectory.trajectory import TimedTrajectory

LEFT, RIGHT = np.arange(7), np.arange(7, 14)
SPREAD = 1.2
"""rad around home of random joints."""


def main() -> None:
    """Print the table."""
    logging.disable()
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cases", type=int, default=2500)
    parser.add_argument("--seed", type=int, default=2)
    arguments = parser.parse_args()
    rng = np.random.default_rng(arguments.seed)
    refused: Counter[str] = Counter()
    took, waits, least, wrong = [], [], np.inf, 0
    with tempfile.TemporaryDirectory() as folder:
        robot = load_robot(str(two_pandas(Path(folder))))
        model, joints, limits = RobotModel.of(robot), robot.descriptor.joints, Limits.of(robot)
        home, exact = np.array(robot.descriptor.home), ExactScene(model, World((), 0.0))
        handlers = Handlers(model, "pandas", SceneStore(Path(folder, "state")), lambda: home)
        handlers.warm_up(lambda _: None)

        def random(arm: NDArray[np.intp]) -> Array:
            return np.clip(home[arm] + rng.uniform(-SPREAD, SPREAD, 7), model.lower[arm], model.upper[arm])

        def asked(group: str, arm: NDArray[np.intp], start: Array, **fields: object) -> PlanRequest:
            goal = JointGoal(kind="joints", position=tuple(random(arm)))
            return PlanRequest(goal=goal, group=group, start=tuple(start), optimize_s=0.0, **fields)

        for _ in range(arguments.cases):
            start = np.concatenate([random(LEFT), random(RIGHT)])
            try:
                alone = handlers.plan(asked("left", LEFT, start, velocity_scale=float(rng.uniform(0.2, 1.0))))
            except ZarmError:
                continue
            motion = TimedTrajectory.of(alone.trajectory, joints)
            rest = motion.rest(float(rng.uniform(0.0, 0.7 * motion.duration)))
            request = asked("right", RIGHT, rest.start, concurrent=rest.message(joints), timeout=5.0)
            began = time.perf_counter()
            try:
                plan = handlers.plan(request)
            except ZarmError as error:
                refused[error.problem.code] += 1
                continue
            took.append(time.perf_counter() - began)
            both = TimedTrajectory.of(plan.trajectory, joints)
            limits.check(both)
            times = np.arange(0.0, both.duration, 0.001)
            states = both.sample(times)
            distance = exact.nearest(states[0]).distance
            expected = rest.sample(np.clip(times, 0.0, rest.duration))[0][:, LEFT]
            wrong += distance <= 0.0 or bool(np.abs(states[0][:, LEFT] - expected).max() > 1e-6)
            least = min(least, distance)
            begins = times[np.abs(states[0][:, RIGHT] - start[RIGHT]).max(axis=1) > 1e-5][0]
            waits.append(begins > 0.05 * rest.duration)
    table = Table("planned", "wrong", "nearest mm", "plan ms, p95", "right arm waits", "refused")
    table.add_row(
        f"{len(took)}",
        f"{wrong}",
        f"{1e3 * least:.1f}",
        f"{1e3 * np.median(took):.1f}, {1e3 * np.percentile(took, 95):.1f}",
        f"{100 * np.mean(waits):.0f} %",
        ", ".join(f"{code} {count}" for code, count in refused.items()),
    )
    Console(width=160).print(table)


if __name__ == "__main__":
    main()
