"""Two workers of one test run: the robots whose drivers must be heard in time, and beside them, as long as they leave it the
processor, everything else."""

from __future__ import annotations

import os

from xdist.scheduler import LoadScopeScheduling

NICENESS = 10
IN_TIME = (
    "tests/access/test_stack",
    "tests/fault/",
    "tests/process/test_deploy_readme",
    "tests/process/executor/test_driver_strategies",
    "tests/process/executor/test_goals",
    "tests/process/test_leeloo_sim",
    "tests/process/test_metrics",
    "tests/process/executor/test_streams",
    "tests/process/test_two_hosts",
    "tests/ros/test_driv",
    "tests/ros/test_leeloo_sim",
    "tests/ros/test_router_failures",
    "tests/ros/test_tutorials",
    "tests/ros/test_ur5e",
)
"""Where tests have a robot that stops when it does not hear its driver for 0.1 s."""


class ByTime(LoadScopeScheduling):
    """Gives one worker all that must be in time, and the other the rest, in their order."""

    def _split_scope(self, nodeid: str) -> str:
        return "in time" if in_time(nodeid) else "the rest"


def in_time(nodeid: str) -> bool:
    """Whether a test is one of a robot that is moved through a driver."""
    return nodeid.startswith(IN_TIME)


def give_way(nodeid: str) -> None:
    """Leave the processor to the other worker where that is in more of a hurry; processes started from now on do so too."""
    if not in_time(nodeid):
        os.setpriority(os.PRIO_PROCESS, 0, NICENESS)
