"""The working memory of kernels: one for each thread, made for the robot at hand."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

from support.trajectories import ROBOT
from zarm_contract.messages import Attached, Capsule
from zarm_geometry.robot_model import RobotModel
from zarm_geometry.working_memory import working_memory

MODEL = RobotModel.of(ROBOT)


def test_working_memory_is_reused_per_thread() -> None:
    mine = working_memory(MODEL.arrays)
    assert working_memory(MODEL.arrays) is mine
    with ThreadPoolExecutor(1) as pool:
        theirs = pool.submit(working_memory, MODEL.arrays).result()
    assert theirs is not mine
    assert theirs.centers is not mine.centers


def test_a_robot_with_more_spheres_gets_larger_memory() -> None:
    rod = Capsule(kind="capsule", name="rod", position=(0.0, 0.0, 0.3), radius=0.01, length=0.4)
    carrying = MODEL.with_attached([Attached(object=rod, touch_links=())], ())
    assert carrying.arrays.reach.shape != MODEL.arrays.reach.shape
    dof, balls = carrying.arrays.reach.shape
    working_memory(MODEL.arrays)
    assert working_memory(carrying.arrays).motion.shape == ((dof + 1) * balls,)
    dof, balls = MODEL.arrays.reach.shape
    assert working_memory(MODEL.arrays).motion.shape == ((dof + 1) * balls,)


def test_a_robot_with_more_pairs_gets_larger_memory() -> None:
    ignoring = MODEL.with_attached([], [MODEL.links[0]])
    for model in (ignoring, MODEL):
        assert len(working_memory(model.arrays).watched) == len(model.links) + len(model.arrays.pairs)
