"""Whether the servo reaches what can be reached: `python tests/benchmarks/reaching.py [--count 20] [--seed 0]`.

A robot (`--robot`, the M1013 unless told otherwise) is led from a random configuration to a random pose, or to random joints, that keep the margin: in free space, behind a panel, past
a ball, near a wall that the margin just allows, near itself, near singularities and the limits of joints, and between boxes. Controller, local
goal and planner run here in one process, and a plan is there in the cycle after it was asked for. A target is reachable where the planner
finds a plan to it with the same margin; it is reached to 1 mm and 0.01 rad, or 0.01 rad in each joint, at rest, within 20 s of the robot's time.

Prints a row for each kind, and how what was not reached can be run again.
"""

from __future__ import annotations

import argparse
import logging
import sys
import tempfile
from collections import Counter, defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from zarm_trajectory.arrays import Array

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np
from rich.console import Console
from rich.table import Table

from support.servo.tracking import Tracker, planner_in
from zarm_contract.errors import ZarmError
from zarm_contract.messages import Cuboid, JointGoal, PlanRequest, PoseGoal, SceneObject, Sphere
from zarm_contract.robot import load_robot
from zarm_geometry.exact import ExactScene
from zarm_geometry.frames import pose_of
from zarm_geometry.robot_model import RobotModel
from zarm_geometry.world import World
from zarm_planner.handlers import Handlers
from zarm_servo.kernels.step import PERIOD
from zarm_servo.tracking.targets import JointTarget, PoseTarget, rotation_vector

SECONDS = 20.0
KEPT_MARGIN = 0.0005
"""Targets keep so much more (m) than the margin, which steps keep 0.3 mm of."""
REACHED = 0.001, 0.01
"""m, rad."""
RESTS = 0.001
"""rad/s of the joint that moves most."""
STANDS = 4.0
"""A robot that has not moved for so long (s) does not move any more."""
PLANNED = 5.0
"""The planner may take so long (s) to find out whether a target is reachable."""


@dataclass(frozen=True)
class Site:
    """The robot, and the margin (m) that it keeps."""

    model: RobotModel
    margin: float

    def keeps(self, objects: Sequence[SceneObject], q: Array) -> bool:
        """Whether a configuration (J,) keeps the margin to these objects and to itself."""
        scene, least = ExactScene(self.model, World(objects, 0.0)), self.margin + KEPT_MARGIN
        return not scene.too_near(q[None], 0.0, least, least) and scene.nearest(q[None]).distance > 0.0


@dataclass(frozen=True)
class Case:
    """A goal (J,) to be reached from `start` (J,), as joints or as the pose of the tip there."""

    objects: tuple[SceneObject, ...]
    start: Array
    goal: Array
    joints: bool

    def target(self, site: Site) -> PoseTarget | JointTarget:
        return JointTarget(self.goal) if self.joints else PoseTarget(site.model.fk_tip(self.goal))


def somewhere(site: Site, rng: np.random.Generator) -> Array:
    """A configuration that keeps the margin to itself, with the tip above the floor."""
    while True:
        q = np.clip(
            np.array(site.model.robot.descriptor.home) + rng.uniform(-2.2, 2.2, site.model.dof),
            site.model.lower + 0.05,
            site.model.upper - 0.05,
        )
        if site.model.fk_tip(q)[2, 3] > 0.1 and site.keeps((), q):
            return q


def free(_: Site, __: np.random.Generator, start: Array, goal: Array) -> tuple[SceneObject, ...]:
    return ()


def between(site: Site, start: Array, goal: Array) -> Array:
    """The middle of both tips."""
    return np.asarray((site.model.fk_tip(start)[:3, 3] + site.model.fk_tip(goal)[:3, 3]) / 2)


def panel(site: Site, rng: np.random.Generator, start: Array, goal: Array) -> tuple[SceneObject, ...]:
    x, y, z = (between(site, start, goal) + rng.normal(0, 0.05, 3)).tolist()
    way = site.model.fk_tip(goal)[:3, 3] - site.model.fk_tip(start)[:3, 3]
    turn = np.arctan2(way[1], way[0]) / 2
    return (
        Cuboid(
            kind="cuboid",
            name="panel",
            position=(x, y, z),
            orientation=(0.0, 0.0, float(np.sin(turn)), float(np.cos(turn))),
            size=(0.04, float(rng.uniform(0.3, 0.7)), float(rng.uniform(0.3, 0.7))),
        ),
    )


def ball(site: Site, rng: np.random.Generator, start: Array, goal: Array) -> tuple[SceneObject, ...]:
    x, y, z = (between(site, start, goal) + rng.normal(0, 0.05, 3)).tolist()
    return (Sphere(kind="sphere", name="ball", position=(x, y, z), radius=float(rng.uniform(0.05, 0.2))),)


def wall(site: Site, rng: np.random.Generator, start: Array, goal: Array) -> tuple[SceneObject, ...]:
    """A wall or a table that the goal is as near to as it may be."""
    side = int(rng.integers(3))
    size, place, step = np.full(3, 4.0), np.zeros(3), np.zeros(3)
    size[side], step[side] = 0.1, -1.0 if side == 2 else float(np.sign(site.model.fk_tip(goal)[side, 3]))
    low, high = 0.0, 3.0
    for _ in range(30):  # how far away it has to be
        away = (low + high) / 2
        wall = box("wall", place + away * step, size)
        low, high = (low, away) if site.keeps([wall], goal) else (away, high)
    return (box("wall", place + (high + rng.uniform(0.0, 0.005)) * step, size),)


def boxes(site: Site, rng: np.random.Generator, start: Array, goal: Array) -> tuple[SceneObject, ...]:
    found = []
    for k in range(12):
        way = rng.normal(size=3)
        way *= rng.uniform(0.35, 1.1) / np.linalg.norm(way)
        found.append(box(f"box{k}", way + (0.0, 0.0, 0.3), rng.uniform(0.05, 0.3, 3)))
    return tuple(item for item in found if all(site.keeps([item], q) for q in (start, goal)))


def box(name: str, place: Array, size: Array) -> Cuboid:
    x, y, z = place.tolist()
    a, b, c = size.tolist()
    return Cuboid(kind="cuboid", name=name, position=(x, y, z), size=(a, b, c))


def singular(site: Site, rng: np.random.Generator, goal: Array) -> Array:
    """A goal with the wrist or the elbow stretched, or nearly."""
    goal = goal.copy()
    elbow, wrist = (2, 4) if site.model.dof == 6 else (3, 5)
    goal[rng.choice((elbow, wrist))] = rng.choice((0.0, 0.02, -0.02, 0.1))
    return np.clip(goal, site.model.lower, site.model.upper)


def limited(site: Site, rng: np.random.Generator, goal: Array) -> Array:
    """A goal with joints at their limits, or nearly."""
    goal = goal.copy()
    for joint in rng.choice(site.model.dof, 2, replace=False):
        at = site.model.upper if rng.random() < 0.5 else site.model.lower
        goal[joint] = at[joint] - np.sign(at[joint]) * rng.choice((0.0, 0.001, 0.02))
    return goal


def tight(site: Site, rng: np.random.Generator, goal: Array) -> Array:
    """A goal at which links are as near to one another as they may be."""
    for _ in range(200):
        other = np.clip(somewhere(site, rng) + rng.normal(0, 1.0, site.model.dof), site.model.lower, site.model.upper)
        if site.keeps((), other):
            continue
        inside, outside = other, goal
        for _ in range(20):
            middle = (inside + outside) / 2
            inside, outside = (inside, middle) if site.keeps((), middle) else (middle, outside)
        return outside
    return goal


Scene = Callable[[Site, np.random.Generator, Array, Array], tuple[SceneObject, ...]]
Goal = Callable[[Site, np.random.Generator, Array], Array]
KINDS: dict[str, tuple[Goal, Scene]] = {
    "free": (lambda _, __, goal: goal, free),
    "behind a panel": (lambda _, __, goal: goal, panel),
    "past a ball": (lambda _, __, goal: goal, ball),
    "near a wall": (lambda _, __, goal: goal, wall),
    "near itself": (tight, free),
    "near a singularity": (singular, free),
    "near joint limits": (limited, free),
    "between boxes": (lambda _, __, goal: goal, boxes),
}


def case(site: Site, kind: str, seed: int) -> Case:
    """The case with this seed."""
    rng = np.random.default_rng((seed, list(KINDS).index(kind)))
    move, scene = KINDS[kind]
    while True:
        start, goal = somewhere(site, rng), move(site, rng, somewhere(site, rng))
        objects = scene(site, rng, start, goal)
        if site.keeps(objects, start) and site.keeps(objects, goal):
            return Case(objects, start, goal, bool(rng.random() < 0.25))


def reachable(site: Site, planner: Handlers, case: Case) -> bool:
    """Whether the planner knows a way with the same margin."""
    pose = pose_of(site.model.fk_tip(case.goal))
    goal: JointGoal | PoseGoal = (
        JointGoal(kind="joints", position=tuple(case.goal.tolist()))
        if case.joints
        else PoseGoal(kind="pose", position=pose.position, orientation=pose.orientation)
    )
    start = tuple(case.start.tolist())
    try:
        planner.plan(
            PlanRequest(
                goal=goal,
                start=start,
                margin=site.margin,
                self_margin=site.margin,
                timeout=PLANNED,
                optimize_s=0.0,
                publish=False,
            )
        )
    except ZarmError:
        return False
    return True


def errors(site: Site, target: PoseTarget | JointTarget, position: Array) -> tuple[float, float]:
    """What is left: m, rad."""
    if isinstance(target, JointTarget):
        return 0.0, float(np.abs(target.position - position).max())
    tip = site.model.fk_tip(position)
    turn = rotation_vector(target.pose[:3, :3] @ tip[:3, :3].T)
    return float(np.linalg.norm(target.pose[:3, 3] - tip[:3, 3])), float(np.linalg.norm(turn))


def led(site: Site, tracker: Tracker, target: PoseTarget | JointTarget) -> tuple[float | None, str]:
    """Lead the robot; after how long (s) it has reached the target, and if it has not, what was left and why."""
    stands, step = 0.0, tracker.step(target)
    for cycle in range(1, round(SECONDS / PERIOD)):
        step = tracker.step(target)
        resting = float(np.abs(step.state[1]).max()) < RESTS
        if resting and bool(np.all(np.less(errors(site, target, step.state[0]), REACHED))):
            return cycle * PERIOD, ""
        stands = stands + PERIOD if resting else 0.0
        if stands > STANDS:
            break
    metres, turn = errors(site, target, step.state[0])
    problem, at = tracker.local_goal.problem, step.limitation
    return None, (
        f"{1e3 * metres:.1f} mm, {turn:.3f} rad left after {cycle * PERIOD:.1f} s, {at.kind} {at.pair or ''}, "
        f"planned: {tracker.local_goal.planned}, {'' if problem is None else problem.code}"
    )


def main() -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=20, help="targets of each kind")
    parser.add_argument("--seed", type=int, default=0, help="seed of the first one")
    parser.add_argument("--kind", choices=KINDS, help="of this kind alone")
    parser.add_argument("--robot", default="doosan_m1013", help="name of a robot that comes with zarm, or a descriptor")
    parser.add_argument("--margin", type=float, default=0.01, help="distance (m) that is kept")
    options = parser.parse_args()
    site = Site(RobotModel.of(load_robot(options.robot)), options.margin)
    logging.disable()
    counts: defaultdict[str, Counter[str]] = defaultdict(Counter)
    seconds: defaultdict[str, list[float]] = defaultdict(list)
    missed = []
    with tempfile.TemporaryDirectory() as folder:
        for kind in [options.kind] if options.kind else KINDS:
            for seed in range(options.seed, options.seed + options.count):
                asked = case(site, kind, seed)
                planner = planner_in(site.model, "arm", Path(folder) / f"{kind}{seed}", asked.objects)
                tracker = Tracker(site.model, asked.objects, planner, asked.start, site.margin)
                after, why = led(site, tracker, asked.target(site))
                if after is not None:
                    seconds[kind].append(after)
                    counts[kind]["reached"] += 1
                elif reachable(site, planner, asked):
                    counts[kind]["missed"] += 1
                    missed.append(
                        f"--robot {options.robot} --margin {site.margin} --kind '{kind}' --count 1 --seed {seed}: {'joints' if asked.joints else 'pose'}, {why}"
                    )
                    sys.stdout.write(missed[-1] + "\n")
                    sys.stdout.flush()
                planner.close()
    table = Table("target", "reached", "reachable, not reached", "s, median", "s, longest")
    for kind, count in counts.items():
        took = seconds[kind] or [np.nan]
        table.add_row(kind, str(count["reached"]), str(count["missed"]), f"{np.median(took):.1f}", f"{max(took):.1f}")
    Console(width=120).print(table)
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
