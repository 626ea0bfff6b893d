"""A router that stalls and goes on moves no arm by what it held up: the arm stays on its path, brakes gently, and goes on to its goal or rests for good."""

from __future__ import annotations

import os
import random
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path as Folder

import numpy as np
import pytest

from support.faults.arena import STEP, Arena
from support.faults.ordeal import STILL, WINDOW, nothing_moves
from support.harness import eventually
from support.trajectories import ROBOT
from zarm_simulated_driver.player import CEILING, STIFFNESS, TICK, Kind
from zarm_trajectory.trajectory import TimedTrajectory

pytestmark = [pytest.mark.timed, pytest.mark.slow]

RUNS = int(os.environ.get("STALL_RUNS", "2"))
"""How often the router stalls under each strategy."""
LONGEST = float(os.environ.get("STALL_SECONDS", "2.5"))
"""The longest stall, s; the shortest is 0.2."""
JOINTS = ROBOT.descriptor.joints


def stall(place: Arena, moment: float, seconds: float) -> tuple[float, float]:
    """Let the router stall for `seconds` at this `moment` (s) of a motion; how far (rad) the arm left its path, and rad/s^2."""
    motion = place.motion()
    path = TimedTrajectory.of(motion, JOINTS)
    goal_id = place.client.execute(motion)
    begin = place.samples()
    eventually(lambda: (place.samples() - begin) * STEP >= moment, "the moment has come")
    place.router.stall()
    stalled = place.samples()
    eventually(lambda: (place.samples() - stalled) * STEP >= seconds, "the router has stalled for long enough")
    place.router.go_on()
    place.all_heard()
    end = place.client.ended(goal_id)
    place.wait_to_stand()
    nothing_moves(place)
    if place.client.state().mode == "fault":
        place.client.command(place.keys.reset)
    nothing_moves(place)
    rows = place.trace()[begin - WINDOW :]
    position, velocity = rows[:, : len(JOINTS)], rows[:, len(JOINTS) :]
    if end.status != "succeeded":
        moving = np.flatnonzero(np.abs(velocity).max(axis=1) > STILL)
        assert np.all(np.diff(moving) < 20), "the arm came to rest and moved again without an execute"
    places = path.sample(np.linspace(0.0, path.duration, 2000))[0]
    off = max(float(np.abs(places - row).max(axis=1).min()) for row in position[::5])
    return off, float(np.abs(velocity[WINDOW:] - velocity[:-WINDOW]).max()) / (WINDOW * STEP)


@pytest.mark.timeout(120 + 30 * RUNS)
@pytest.mark.parametrize(
    ("strategy", "plays"),
    [("joint_speed", "velocity"), ("joint_pose", "position"), ("joint_trajectory", "velocity")],
)
def test_what_a_stalled_router_held_up_never_moves_the_arm(
    tmp_path: Folder, note: Callable[..., None], strategy: str, plays: Kind
) -> None:
    chance = random.Random(strategy)
    with ExitStack() as stack:
        place = Arena(stack, tmp_path, strategy, wired=False, stallable=True, plays=plays)
        figures = [
            stall(place, chance.uniform(0.05, 2.2), 0.2 * (LONGEST / 0.2) ** chance.random()) for _ in range(RUNS)
        ]
        place.nudge()
    off, acceleration = (max(column) for column in zip(*figures, strict=True))
    note(f"router stalls, {RUNS} times", f"`{strategy}`", "", "", f"{acceleration:.2f}", f"{off:.3f} rad off the path")
    assert off <= ROBOT.descriptor.execution.path_tolerance
    # Executor and driver tick each for itself: a chunk may begin a point off, and a drive that plays positions makes up for that.
    one_point = (
        max(ROBOT.descriptor.cspace.velocity) * TICK * STIFFNESS / (WINDOW * STEP) if plays == "position" else 0.0
    )
    assert acceleration <= CEILING * 1.1 + one_point
