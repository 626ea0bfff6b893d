"""What keeping the torques costs: `python tests/benchmarks/torque.py [--every 3] [--mass 3.0] [--paths 200]`.

MotionBenchMaker's problems for the Panda, with the joint ranges, limits and efforts of the descriptor that comes with zarm, and a mass at its flange:
planned without the mass and with it, in turn. `over before` are the motions without the mass that would need more than an effort with it, `over`
those planned with it, both looked at every millisecond. Needs the problems in ../shared/mbm.

Then random paths, whose motions would need more than an effort: how long they take within the efforts, by the whole
motion slowed down, and by TOPPRA under the same velocities, accelerations and torques, which does not limit jerk.
"""

from __future__ import annotations

import argparse
import logging
import math
import sys
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

from zarm_trajectory.arrays import Array

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np
from rich.console import Console
from rich.table import Table
from toppra import SplineInterpolator
from toppra.algorithm import TOPPRA
from toppra.constraint import JointAccelerationConstraint, JointTorqueConstraint, JointVelocityConstraint

from support.planner import motion_bench
from zarm_contract.errors import ZarmError
from zarm_contract.messages import (
    AttachObject,
    DetachObject,
    JointGoal,
    LoadScene,
    Plan,
    PlanRequest,
    SceneEdit,
    Sphere,
)
from zarm_contract.robot import load_robot
from zarm_geometry.dynamics import Dynamics, Weight, weights_of
from zarm_geometry.robot_model import RobotModel
from zarm_geometry.world import World
from zarm_planner.deadline import Deadline
from zarm_planner.handlers import Handlers
from zarm_planner.scene.store import SceneStore
from zarm_planner.timing.smoothing import smooth_path
from zarm_planner.timing.torque import TooHeavy, within_torque
from zarm_trajectory.limits import Limits
from zarm_trajectory.trajectory import TimedTrajectory

PANDA = load_robot("panda")
MODEL = RobotModel.of(PANDA)
HOME = np.array(PANDA.descriptor.home)
FLANGE = "panda_link8"


def worst(plan: Plan, dynamics: Dynamics) -> float:
    """The largest share of an effort."""
    motion = TimedTrajectory.of(plan.trajectory, PANDA.descriptor.joints)
    states = motion.sample(np.arange(0.0, motion.duration, 0.001))
    return float((np.abs(dynamics.torque(*states)) / dynamics.limit).max())


def planned(handlers: Handlers, request: PlanRequest) -> tuple[Plan | None, float]:
    began = time.process_time()
    try:
        plan = handlers.plan(request)
    except ZarmError:
        plan = None
    return plan, time.process_time() - began


def carrying(mass: float) -> Dynamics:
    """The robot with a mass at its flange."""
    weights = weights_of(PANDA)
    if weights is None or MODEL.dynamics is None:
        raise SystemExit("the inertia of the Panda is unknown")
    load = Weight(MODEL.dof - 1, mass, np.array([0.0, 0.0, 0.1]), 1e-3 * mass * np.eye(3))
    return Dynamics.of(MODEL.tree, (*weights, load), MODEL.dynamics.limit)


def toppra_time(motion: TimedTrajectory, limits: Limits, dynamics: Dynamics) -> float:
    """How long (s) the path of a motion takes by TOPPRA."""
    path = SplineInterpolator(motion.time, motion.position)
    dof = motion.position.shape[1]

    def torque(q: Array, v: Array, a: Array) -> Array:
        return dynamics.torque(*(each[None] for each in (q, v, a)))[0]

    constraints = [
        JointVelocityConstraint(limits.velocity),
        JointAccelerationConstraint(limits.acceleration),
        JointTorqueConstraint(torque, np.stack((-dynamics.limit, dynamics.limit), axis=1), np.zeros(dof)),
    ]
    grid = np.linspace(0.0, motion.duration, int(motion.duration / 0.003))
    solver = TOPPRA(constraints, path, gridpoints=grid, solver_wrapper="seidel")
    solver.compute_parameterization(0.0, 0.0)
    speed = solver.problem_data.sd_vec
    return float("nan") if speed is None else float((2.0 * np.diff(grid) / (speed[1:] + speed[:-1])).sum())


class Outcome(NamedTuple):
    """Of each problem solved both ways how long the plan took and how long its motion lasts (s), without and with the mass; the
    numbers of motions that need more than an effort, and of problems solved.
    """

    times: list[tuple[float, float]]
    lasts: list[tuple[float, float]]
    over: list[int]
    solved: list[int]

    @classmethod
    def of(cls, parts: list[Outcome]) -> Outcome:
        """All of them together."""
        over, solved = (np.sum([getattr(part, name) for part in parts], axis=0).tolist() for name in ("over", "solved"))
        return cls([t for part in parts for t in part.times], [t for part in parts for t in part.lasts], over, solved)

    def cells(self) -> tuple[str, ...]:
        """A row of the table."""
        took, lasts = np.array(self.times), np.array(self.lasts)
        ratio = lasts[:, 1] / lasts[:, 0]
        return (
            f"{self.solved[0]}, {self.solved[1]}", f"{1e3 * np.median(took[:, 1]):.1f}",
            f"{np.median(took[:, 1] / took[:, 0]):.2f}", f"{lasts[:, 1].mean():.2f}",
            f"{ratio.mean():.3f}, {np.percentile(ratio, 95):.2f}", f"{self.over[0]} / {len(took)}", str(self.over[1]),
        )  # fmt: skip


def random_paths(count: int, mass: float) -> Table:
    """Motions through three random configurations, carrying a mass."""
    dynamics, limits, rng = carrying(mass), Limits.of(PANDA), np.random.default_rng(0)
    rows, over, heavy = [], 0, 0
    for seed in range(count):
        path = rng.uniform(np.maximum(MODEL.lower, -2.5), np.minimum(MODEL.upper, 2.5), (3, MODEL.dof))
        motion = smooth_path(MODEL, World((), 0.0), path, limits, 0.01, seed=seed, deadline=Deadline(math.inf))
        try:
            slower, _ = within_torque(dynamics, motion, limits)
        except TooHeavy:
            heavy += 1
            continue
        states = slower.sample(np.arange(0.0, slower.duration, 0.001))
        over += bool((np.abs(dynamics.torque(*states)) > dynamics.limit).any())
        if slower is not motion:
            states = motion.sample(np.arange(0.0, motion.duration, 0.001))
            holding = dynamics.holding(states[0])
            moving = dynamics.torque(*states) - holding
            whole = float(np.sqrt((np.abs(moving) / (dynamics.limit - np.sign(moving) * holding)).max()))
            rows.append((motion.duration, slower.duration, whole, toppra_time(motion, limits, dynamics)))
    before, ours, whole, least = np.array(rows).T
    table = Table(
        "motions", "too heavy", "would need more", "do", "time / before", "slowed as a whole", "time / TOPPRA, p95"
    )
    ratio = (ours / least)[np.isfinite(least)]
    table.add_row(
        f"{count}", f"{heavy}", f"{len(rows)}", f"{over}", f"{(ours / before).mean():.3f}", f"{whole.mean():.3f}",
        f"{ratio.mean():.3f}, {np.percentile(ratio, 95):.3f}",
    )  # fmt: skip
    return table


def main() -> None:
    """Print the tables."""
    logging.disable()
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--every", type=int, default=3)
    parser.add_argument("--mass", type=float, default=3.0)
    parser.add_argument("--paths", type=int, default=200)
    arguments = parser.parse_args()
    at_flange = tuple(MODEL.fk_link(FLANGE, HOME)[:3, 3].tolist())
    mass = Sphere(kind="sphere", name="mass", position=at_flange, radius=0.01)
    touch = tuple(PANDA.descriptor.collision)
    table = Table(
        "scene",
        "solved without, with",
        "plan ms",
        "with / without",
        "motion s",
        "with / without, p95",
        "over before",
        "over",
    )
    outcomes = []
    for scene in motion_bench.SCENES:
        found = Outcome([], [], [0, 0], [0, 0])
        with tempfile.TemporaryDirectory() as folder:
            handlers = Handlers(MODEL, "panda", SceneStore(Path(folder)), lambda: HOME)
            handlers.warm_up(lambda _: None)
            for problem in motion_bench.problems("panda", scene)[:: arguments.every]:
                handlers.edit(SceneEdit(edit=LoadScene(op="load", objects=(*problem.objects, mass))))
                goal = JointGoal(kind="joints", position=problem.goals[0])
                request = PlanRequest(goal=goal, start=problem.start, optimize_s=0.0, margin=0.0)
                ready = {
                    "op": "attach",
                    "name": "mass",
                    "touch_links": touch,
                    "link": FLANGE,
                    "joints": tuple(HOME.tolist()),
                }
                plans = []
                for kilograms in (None, arguments.mass):
                    handlers.edit(SceneEdit(edit=AttachObject(**ready, mass=kilograms)))
                    plans.append(planned(handlers, request))
                    loaded = handlers.scenes.present(0.0).exact.model.dynamics
                    handlers.edit(SceneEdit(edit=DetachObject(op="detach", name="mass", joints=tuple(HOME.tolist()))))
                (light, quick), (heavy, took) = plans
                found.solved[0] += light is not None
                found.solved[1] += heavy is not None
                if light is None or heavy is None or loaded is None:
                    continue
                found.times.append((quick, took))
                found.lasts.append((light.trajectory.time[-1], heavy.trajectory.time[-1]))
                found.over[0] += worst(light, loaded) > 1.0
                found.over[1] += worst(heavy, loaded) > 1.0
        outcomes.append(found)
        table.add_row(scene, *found.cells())
    table.add_row("all", *Outcome.of(outcomes).cells())
    console = Console(width=160)
    console.print(table)
    console.print(random_paths(arguments.paths, arguments.mass))


if __name__ == "__main__":
    main()
