"""What keeping the torques costs: `python tests/benchmarks/torque.py [--every 3] [--mass 3.0]`.

MotionBenchMaker's problems for the Panda, with the joint ranges, limits and efforts of the descriptor that comes with zarm, and a mass at its flange:
planned without the mass and with it, in turn. `over before` are the motions without the mass that would need more than an effort with it, `over`
those planned with it, both looked at every millisecond. Needs the problems in ../shared/mbm.
"""

from __future__ import annotations

import argparse
import logging
import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np
from rich.console import Console
from rich.table import Table

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
from zarm_geometry.dynamics import Dynamics
from zarm_geometry.robot_model import RobotModel
from zarm_planner.handlers import Handlers
from zarm_planner.scene.store import SceneStore
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


def main() -> None:
    """Print the table."""
    logging.disable()
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--every", type=int, default=3)
    parser.add_argument("--mass", type=float, default=3.0)
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
    for scene in motion_bench.SCENES:
        pairs, times, over, solved = [], [], [0, 0], [0, 0]
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
                    carrying = handlers.scenes.present(0.0).exact.model.dynamics
                    handlers.edit(SceneEdit(edit=DetachObject(op="detach", name="mass", joints=tuple(HOME.tolist()))))
                (light, quick), (heavy, took) = plans
                solved[0] += light is not None
                solved[1] += heavy is not None
                if light is None or heavy is None or carrying is None:
                    continue
                times.append((quick, took))
                pairs.append((light.trajectory.time[-1], heavy.trajectory.time[-1]))
                over[0] += worst(light, carrying) > 1.0
                over[1] += worst(heavy, carrying) > 1.0
        took, lasts = np.array(times), np.array(pairs)
        ratio = lasts[:, 1] / lasts[:, 0]
        table.add_row(
            scene, f"{solved[0]}, {solved[1]}", f"{1e3 * np.median(took[:, 1]):.1f}",
            f"{np.median(took[:, 1] / took[:, 0]):.2f}", f"{lasts[:, 1].mean():.2f}",
            f"{ratio.mean():.3f}, {np.percentile(ratio, 95):.2f}", f"{over[0]} / {len(pairs)}", str(over[1]),
        )  # fmt: skip
    Console(width=160).print(table)


if __name__ == "__main__":
    main()
