"""Two arms that hold one bar: `python tests/benchmarks/held_together.py [--count 500] [--seed 0]`.

Two Pandas and two M1013, face to face over a table with four boxes on it, as in `two_arms.py`. Both tips hold a bar of 0.3 m, the left one carries it
as an attached object. A problem leads from a random pose of the bar to where a random walk that keeps the pose between the tips ends, so each has a
solution; the planner gets the pose of the left tip there, and the right arm follows. From request to verified motion, CPU time of one thread.

Every motion is looked at again at 500 moments: how far the tips are off each other, and in exact geometry.
"""

from __future__ import annotations

import argparse
import logging
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

from zarm_trajectory.arrays import Array

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np
from path_constraint import wander
from rich.console import Console
from rich.table import Table
from two_arms import CELLS, FACING, MARGIN, objects

from support.composed import composed
from zarm_contract.errors import PlanningFailed, ZarmError
from zarm_contract.messages import (
    AddObjects,
    AttachObject,
    Cuboid,
    GroupGoal,
    GroupsGoal,
    PathConstraint,
    PlanRequest,
    PoseGoal,
    SceneEdit,
)
from zarm_contract.robot import load_robot
from zarm_geometry.exact import ExactScene
from zarm_geometry.frames import pose_of
from zarm_geometry.robot_model import RobotModel
from zarm_geometry.world import World
from zarm_planner.constraints.path_constraint import ConstraintManifold
from zarm_planner.handlers import Handlers
from zarm_planner.scene.store import SceneStore
from zarm_trajectory.trajectory import TimedTrajectory

HELD = PathConstraint(axes=(True,) * 6, group="right", relative_to="left")
LENGTH = 0.3
"""Of the bar (m)."""
BAR = np.array([[1.0, 0.0, 0.0, -0.5 * LENGTH], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.02], [0.0, 0.0, 0.0, 1.0]])
"""The bar in the frame of the left tip."""
NEAREST = 0.5
"""Rad: a goal nearer to the start than this is no problem."""
TIMEOUT = 5.0


def goal(pose: Array) -> PoseGoal:
    """A pose as a goal."""
    where = pose_of(pose)
    return PoseGoal(kind="pose", position=where.position, orientation=where.orientation)


def grips(bar: Array) -> GroupsGoal:
    """Both tips at the ends of the bar (4, 4), pointing down."""
    goals = []
    for name, side in (("left", 0.5), ("right", -0.5)):
        tip = bar @ np.diag([1.0, -1.0, -1.0, 1.0])
        tip[:3, 3] += bar[:3, 0] * side * LENGTH
        goals.append(GroupGoal(group=name, goal=goal(tip)))
    return GroupsGoal(kind="groups", goals=tuple(goals))


def problems(
    handlers: Handlers, model: RobotModel, world: World, rng: np.random.Generator
) -> Iterator[tuple[Array, Array]]:
    """Starts and ends (dof,) with the bar held, without end."""
    while True:
        bar = np.eye(4)
        bar[:3, 3] = rng.uniform((-0.2, -0.3, 0.3), (0.2, 0.3, 0.7))
        angle = rng.uniform(-0.5, 0.5)
        bar[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
        try:
            plan = handlers.plan(PlanRequest(goal=grips(bar), optimize_s=0.0))
        except PlanningFailed:
            continue
        start = np.clip(plan.trajectory.position[-1], model.lower, model.upper)
        end = wander(world, ConstraintManifold.of(model, HELD, start), start, rng)
        if np.linalg.norm(end - start) >= NEAREST:
            yield start, end


def measured(robot: str, apart: float, count: int, seed: int) -> list[str]:
    """A row of the table."""
    rng = np.random.default_rng(seed)
    with tempfile.TemporaryDirectory() as folder:
        model = RobotModel.of(load_robot(str(composed(Path(folder), FACING.format(robot=robot, apart=apart)))))
        store = SceneStore(Path(folder))
        handlers = Handlers(model, "facing", store, lambda: np.array(model.robot.descriptor.home))
        handlers.warm_up(lambda _: None)
        placed = objects(apart)
        at = pose_of(model.fk_tip(model.robot.descriptor.home, "left") @ BAR)
        size = (LENGTH, 0.03, 0.03)
        bar = Cuboid(kind="cuboid", name="bar", position=at.position, orientation=at.orientation, size=size)
        handlers.edit(SceneEdit(edit=AddObjects(op="add", objects=(*placed, bar))))
        attach = AttachObject(
            op="attach",
            name="bar",
            link=model.robot.descriptor.groups["left"].tip_link,
            touch_links=tuple(
                name for name in model.links if any(part in name for part in ("hand", "finger", "link_6"))
            ),
        )
        handlers.edit(SceneEdit(edit=attach))
        carrying = model.with_attached(store.scene.attached, ())
        world = World(placed, MARGIN)
        exact = ExactScene(carrying, World(placed, 0.0))
        took: list[float] = []
        stages: list[tuple[float, float, float]] = []
        faults: Counter[str] = Counter()
        off: list[float] = []
        for number, (start, end) in zip(range(count), problems(handlers, carrying, world, rng), strict=False):
            request = PlanRequest(
                goal=goal(model.fk_tip(end, "left")),
                group="left",
                path_constraint=HELD,
                start=tuple(start.tolist()),
                optimize_s=0.0,
                seed=number,
                timeout=TIMEOUT,
            )
            began = time.process_time()
            try:
                plan = handlers.plan(request)
            except ZarmError as error:
                faults[error.problem.code] += 1
                continue
            took.append(time.process_time() - began)
            stages.append((plan.timings.ik, plan.timings.search + plan.timings.shortcut, plan.timings.timing))
            trajectory = TimedTrajectory.of(plan.trajectory, model.robot.descriptor.joints)
            dense = trajectory.positions(np.linspace(0.0, trajectory.duration, 500))
            between = np.linalg.inv(model.fk_tip(dense, "left")) @ model.fk_tip(dense, "right")
            off.append(float(np.linalg.norm(between[:, :3, 3] - between[0, :3, 3], axis=1).max()))
            faults["contact"] += exact.nearest(dense).distance <= 0.0
    ik, search, timing = 1e3 * np.median(np.array(stages), axis=0)
    return [
        f"two {robot}",
        f"{len(took)} / {count}",
        f"{1e3 * np.median(took):.1f} / {1e3 * np.percentile(took, 95):.1f}",
        f"{ik:.1f} / {search:.1f} / {timing:.1f}",
        f"{1e3 * max(off):.2f}",
        str(faults["contact"]),
        ", ".join(f"{code} {number}" for code, number in faults.items() if code != "contact") or "-",
    ]


def main() -> None:
    """Measure both cells."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=500, help="problems of each pair of arms")
    parser.add_argument("--seed", type=int, default=0, help="of the problems")
    asked = parser.parse_args()
    logging.disable(logging.CRITICAL)
    table = Table("arms", "solved", "plan ms", "IK / search / timing ms", "off mm", "contacts", "not solved")
    for robot, apart in CELLS.items():
        table.add_row(*measured(robot, apart, asked.count, asked.seed))
    Console(width=160).print(
        table,
        "Times: median / 95th percentile; stages: medians. Off: the farthest that the tips were from where they hold the bar.",
    )


if __name__ == "__main__":
    main()
