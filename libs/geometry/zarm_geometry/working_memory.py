"""The working memory of kernels: each thread has its own, which all its calls use in turn."""

from __future__ import annotations

import threading

from zarm_geometry.kernels.arrays import Memory, RobotArrays, memory


class _Kept(threading.local):
    """What this thread used last, and the numbers of joints, balls, links and pairs that it is for."""

    sizes: tuple[int, ...] = ()
    memory: Memory


_kept = _Kept()


def working_memory(robot: RobotArrays) -> Memory:
    """This thread's working memory for one kernel call for this robot; the next call overwrites it."""
    sizes = *robot.reach.shape, len(robot.link_joint), len(robot.pairs)
    if _kept.sizes != sizes:
        _kept.memory = memory(robot)
        _kept.sizes = sizes
    return _kept.memory
