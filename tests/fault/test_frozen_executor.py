"""An executor that stands still for less than a second in motion goes on, whatever moves the robot."""

from __future__ import annotations

import os
import random
import signal
from contextlib import ExitStack
from pathlib import Path as Folder

import pytest

from support.faults.arena import STEP, Arena
from support.harness import eventually
from zarm_executor.machine import STALL_LIMIT
from zarm_simulated_driver.player import Kind

pytestmark = [pytest.mark.timed, pytest.mark.slow]

RUNS = int(os.environ.get("FREEZE_RUNS", "2"))


@pytest.mark.timeout(120 + 20 * RUNS)
@pytest.mark.parametrize(
    ("strategy", "plays"),
    [("joint_speed", "velocity"), ("joint_pose", "position"), ("joint_trajectory", "velocity")],
)
def test_after_a_short_freeze_the_goal_is_reached(tmp_path: Folder, strategy: str, plays: Kind) -> None:
    chance = random.Random(strategy)
    with ExitStack() as stack:
        place = Arena(stack, tmp_path, strategy, wired=False, plays=plays)
        for _ in range(RUNS):
            begin = place.samples()
            goal_id = place.go()
            moment, seconds = chance.uniform(0.05, 1.5), chance.uniform(0.15, 0.85 * STALL_LIMIT)
            eventually(lambda n=begin, t=moment: (place.samples() - n) * STEP >= t, "the moment has come")  # type: ignore[misc]
            os.kill(place.executor.process.pid, signal.SIGSTOP)
            frozen = place.samples()
            eventually(lambda n=frozen, t=seconds: (place.samples() - n) * STEP >= t, "it has stood still")  # type: ignore[misc]
            os.kill(place.executor.process.pid, signal.SIGCONT)
            end = place.client.ended(goal_id)
            assert end.status == "succeeded", f"{end.problem} after {seconds} s at {moment} s"
            place.wait_to_stand()
