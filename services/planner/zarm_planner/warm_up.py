"""Compile every kernel before the first request, or load what an earlier process compiled.

`python -m zarm_planner.warm_up` does it after an installation, so that no planner has to.
"""

from __future__ import annotations

import itertools
import sys
from collections.abc import Callable

import numpy as np

from zarm_contract.messages import HeldAxes
from zarm_contract.robot import load_robot
from zarm_geometry.collision import is_free
from zarm_geometry.exact import ExactScene
from zarm_geometry.robot_model import RobotModel
from zarm_geometry.world import World
from zarm_planner.held import Held
from zarm_planner.held_motion import search_held, shorten_held
from zarm_planner.ik import solve_ik
from zarm_planner.motion import Limits
from zarm_planner.search import search
from zarm_planner.shorten import quickest_of, shorten
from zarm_planner.smooth import smooth_path
from zarm_planner.stop import Stop

STAGES = 8


def warm_up(model: RobotModel, report: Callable[[str], None]) -> None:
    """Run each kernel once; `report` is told what comes next. About 25 s after an installation, then 0.3 s.

    The compiled kernels serve every robot and every scene; nothing is compiled after this.
    """
    number = itertools.count(1)

    def begin(stage: str) -> None:
        report(f"loading {stage} ({next(number)} of {STAGES})")

    world, stop = World((), 0.0), Stop(60.0)
    home = np.array(model.robot.descriptor.home)
    begin("forward kinematics")
    pose = model.fk_tip(home)
    begin("collision checks")
    is_free(model, world, home)
    begin("inverse kinematics")
    solve_ik(model, pose, home, world=world, max_solutions=1, seed=0, stop=stop)
    begin("the search")
    search(model, world, home, home, seed=0, stop=stop)
    begin("the shortening of paths")
    shorten(model, world, np.array((home, home)), seed=0, stop=stop)
    quickest_of(model, world, home, home, seeds=(0,), stop=stop, most=1)
    begin("the smoothing of motions")
    away = np.clip(home + 0.1, model.lower, model.upper)
    limits = Limits.of(model)
    motion = smooth_path(model, world, np.array((home, away)), limits, 0.01, seed=0, stop=stop)
    begin("the verification of motions")
    exact = ExactScene(model, world)
    motion.load(limits)
    motion.travel(exact.reach)
    exact.nearest(motion.at(motion.time)[0])
    begin("the search for motions that hold axes")
    held = Held.of(model, HeldAxes(axes=(False, False, False, True, True, True)), pose)
    held.use(home)
    path = search_held(world, held, home, home[None], seed=0, stop=stop)
    if path is not None:
        shorten_held(world, held, path, seed=0, stop=stop)


def _print_line(text: str) -> None:
    sys.stdout.write(f"{text}\n")
    sys.stdout.flush()


if __name__ == "__main__":
    warm_up(RobotModel.of(load_robot("doosan_m1013")), _print_line)
