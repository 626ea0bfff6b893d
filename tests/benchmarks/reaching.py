"""Whether the servo reaches what can be reached: `python tests/benchmarks/reaching.py [--count 20] [--seed 0]`.

The M1013 is led from a random configuration to a random pose, or to random joints, that keep the margin: in free space, behind a panel, past
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
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np
from numpy.typing import NDArray
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
from zarm_servo.controller import PERIOD
from zarm_servo.targets import JointTarget, PoseTarget, rotation_vector

Array = NDArray[np.float64]

MARGIN, SECONDS = 0.01, 20.0
ROOM = 0.0005
"""Targets keep so much more (m) than the margin, which steps keep 0.3 mm of."""
REACHED = 0.001, 0.01
"""m, rad."""
RESTS = 0.001
"""rad/s of the joint that moves most."""
STANDS = 4.0
"""A robot that has not moved for so long (s) does not move any more."""
PLANNED = 5.0
"""The planner may take so long (s) to find out whether a target is reachable."""
MODEL = RobotModel.of(load_robot("doosan_m1013"))
HOME = np.array(MODEL.robot.descriptor.home)
ALONE = ExactScene(MODEL, World((), 0.0))


@dataclass(frozen=True)
class Case:
    """A goal (J,) to be reached from `start` (J,), as joints or as the pose of the tip there."""

    objects: tuple[SceneObject, ...]
    start: Array
    goal: Array
    joints: bool

    @property
    def target(self) -> PoseTarget | JointTarget:
        return JointTarget(self.goal) if self.joints else PoseTarget(MODEL.fk_tip(self.goal))


def somewhere(rng: np.random.Generator) -> Array:
    """A configuration that keeps the margin to itself, with the tip above the floor."""
    while True:
        q = np.clip(HOME + rng.uniform(-2.2, 2.2, MODEL.dof), MODEL.lower + 0.05, MODEL.upper - 0.05)
        if MODEL.fk_tip(q)[2, 3] > 0.1 and keeps(ALONE, q):
            return q


def keeps(scene: ExactScene, q: Array) -> bool:
    return not scene.too_near(q[None], 0.0, MARGIN + ROOM, MARGIN + ROOM) and scene.nearest(q[None]).distance > 0.0


def free(_: np.random.Generator, start: Array, goal: Array) -> tuple[SceneObject, ...]:
    return ()


def between(start: Array, goal: Array) -> Array:
    """The middle of both tips."""
    return np.asarray((MODEL.fk_tip(start)[:3, 3] + MODEL.fk_tip(goal)[:3, 3]) / 2)


def panel(rng: np.random.Generator, start: Array, goal: Array) -> tuple[SceneObject, ...]:
    x, y, z = (between(start, goal) + rng.normal(0, 0.05, 3)).tolist()
    way = MODEL.fk_tip(goal)[:3, 3] - MODEL.fk_tip(start)[:3, 3]
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


def ball(rng: np.random.Generator, start: Array, goal: Array) -> tuple[SceneObject, ...]:
    x, y, z = (between(start, goal) + rng.normal(0, 0.05, 3)).tolist()
    return (Sphere(kind="sphere", name="ball", position=(x, y, z), radius=float(rng.uniform(0.05, 0.2))),)


def wall(rng: np.random.Generator, start: Array, goal: Array) -> tuple[SceneObject, ...]:
    """A wall or a table that the goal is as near to as it may be."""
    side = int(rng.integers(3))
    size, place, step = np.full(3, 4.0), np.zeros(3), np.zeros(3)
    size[side], step[side] = 0.1, -1.0 if side == 2 else float(np.sign(MODEL.fk_tip(goal)[side, 3]))
    low, high = 0.0, 3.0
    for _ in range(30):  # how far away it has to be
        away = (low + high) / 2
        wall = box("wall", place + away * step, size)
        low, high = (low, away) if keeps(ExactScene(MODEL, World([wall], 0.0)), goal) else (away, high)
    return (box("wall", place + (high + rng.uniform(0.0, 0.005)) * step, size),)


def boxes(rng: np.random.Generator, start: Array, goal: Array) -> tuple[SceneObject, ...]:
    found = []
    for k in range(12):
        way = rng.normal(size=3)
        way *= rng.uniform(0.35, 1.1) / np.linalg.norm(way)
        found.append(box(f"box{k}", way + (0.0, 0.0, 0.3), rng.uniform(0.05, 0.3, 3)))
    return tuple(item for item in found if all(keeps(ExactScene(MODEL, World([item], 0.0)), q) for q in (start, goal)))


def box(name: str, place: Array, size: Array) -> Cuboid:
    x, y, z = place.tolist()
    a, b, c = size.tolist()
    return Cuboid(kind="cuboid", name=name, position=(x, y, z), size=(a, b, c))


def singular(rng: np.random.Generator, goal: Array) -> Array:
    """A goal with the wrist or the elbow stretched, or nearly."""
    goal = goal.copy()
    goal[rng.choice((2, 4))] = rng.choice((0.0, 0.02, -0.02, 0.1))
    return goal


def limited(rng: np.random.Generator, goal: Array) -> Array:
    """A goal with joints at their limits, or nearly."""
    goal = goal.copy()
    for joint in rng.choice(MODEL.dof, 2, replace=False):
        at = MODEL.upper if rng.random() < 0.5 else MODEL.lower
        goal[joint] = at[joint] - np.sign(at[joint]) * rng.choice((0.0, 0.001, 0.02))
    return goal


def tight(rng: np.random.Generator, goal: Array) -> Array:
    """A goal at which links are as near to one another as they may be."""
    for _ in range(200):
        other = np.clip(somewhere(rng) + rng.normal(0, 1.0, MODEL.dof), MODEL.lower, MODEL.upper)
        if keeps(ALONE, other):
            continue
        inside, outside = other, goal
        for _ in range(20):
            middle = (inside + outside) / 2
            inside, outside = (inside, middle) if keeps(ALONE, middle) else (middle, outside)
        return outside
    return goal


Scene = Callable[[np.random.Generator, Array, Array], tuple[SceneObject, ...]]
Goal = Callable[[np.random.Generator, Array], Array]
KINDS: dict[str, tuple[Goal, Scene]] = {
    "free": (lambda _, goal: goal, free),
    "behind a panel": (lambda _, goal: goal, panel),
    "past a ball": (lambda _, goal: goal, ball),
    "near a wall": (lambda _, goal: goal, wall),
    "near itself": (tight, free),
    "near a singularity": (singular, free),
    "near joint limits": (limited, free),
    "between boxes": (lambda _, goal: goal, boxes),
}


def case(kind: str, seed: int) -> Case:
    """The case with this seed."""
    rng = np.random.default_rng((seed, list(KINDS).index(kind)))
    move, scene = KINDS[kind]
    while True:
        start, goal = somewhere(rng), move(rng, somewhere(rng))
        objects = scene(rng, start, goal)
        exact = ExactScene(MODEL, World(objects, 0.0))
        if keeps(exact, start) and keeps(exact, goal):
            return Case(objects, start, goal, bool(rng.random() < 0.25))


def reachable(planner: Handlers, case: Case) -> bool:
    """Whether the planner knows a way with the same margin."""
    pose = pose_of(MODEL.fk_tip(case.goal))
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
                margin=MARGIN,
                self_margin=MARGIN,
                timeout=PLANNED,
                optimize_s=0.0,
                publish=False,
            )
        )
    except ZarmError:
        return False
    return True


def errors(target: PoseTarget | JointTarget, position: Array) -> tuple[float, float]:
    """What is left: m, rad."""
    if isinstance(target, JointTarget):
        return 0.0, float(np.abs(target.position - position).max())
    tip = MODEL.fk_tip(position)
    turn = rotation_vector(target.pose[:3, :3] @ tip[:3, :3].T)
    return float(np.linalg.norm(target.pose[:3, 3] - tip[:3, 3])), float(np.linalg.norm(turn))


def led(tracker: Tracker, target: PoseTarget | JointTarget) -> tuple[float | None, str]:
    """Lead the robot; after how long (s) it has reached the target, and if it has not, what was left and why."""
    stands, step = 0.0, tracker.step(target)
    for cycle in range(1, round(SECONDS / PERIOD)):
        step = tracker.step(target)
        resting = float(np.abs(step.state[1]).max()) < RESTS
        if resting and bool(np.all(np.less(errors(target, step.state[0]), REACHED))):
            return cycle * PERIOD, ""
        stands = stands + PERIOD if resting else 0.0
        if stands > STANDS:
            break
    metres, turn = errors(target, step.state[0])
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
    options = parser.parse_args()
    logging.disable()
    counts: defaultdict[str, Counter[str]] = defaultdict(Counter)
    seconds: defaultdict[str, list[float]] = defaultdict(list)
    missed = []
    with tempfile.TemporaryDirectory() as folder:
        for kind in [options.kind] if options.kind else KINDS:
            for seed in range(options.seed, options.seed + options.count):
                asked = case(kind, seed)
                planner = planner_in(MODEL, "arm", Path(folder) / f"{kind}{seed}", asked.objects)
                after, why = led(Tracker(MODEL, asked.objects, planner, asked.start, MARGIN), asked.target)
                if after is not None:
                    seconds[kind].append(after)
                    counts[kind]["reached"] += 1
                elif reachable(planner, asked):
                    counts[kind]["missed"] += 1
                    missed.append(
                        f"--kind '{kind}' --count 1 --seed {seed}: {'joints' if asked.joints else 'pose'}, {why}"
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
