"""What a link that stalls holds up never moves the arm when it comes at last; a short stall holds the motion, whatever the strategy."""

from __future__ import annotations

from pathlib import Path as Folder

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from support.arrivals import arrival
from support.examples import examples
from support.executor.driver_bench import MOVING, Case, DriverBench, distance_from
from support.trajectories import HOME, trapezoid
from zarm_contract.messages import DriverCommand
from zarm_runtime.expiry import Expiry
from zarm_simulated_driver.player import CEILING

DRIVEN = [case for case in MOVING if case.strategy != "emulator"]
STILL = 1e-3
"""What is slower (rad/s) is at rest."""


def stalled_for(folder: Folder, case: Case, after: float, seconds: float, rate: float) -> DriverBench:
    """A planned motion in which the link stalls; every promise of it is held."""
    bench = DriverBench(case, folder, rate, ceiling=1000.0)
    tolerance = bench.robot.descriptor.execution.path_tolerance
    path = bench.execute(timed=trapezoid)
    bench.run(after)
    bench.stall(seconds)
    bench.run(seconds + 6.0)
    unheard = [command for moment, command in bench.commands if bench.stalled_at + 0.12 < moment < bench.stalled_until]
    assert all(not command.time for command in unheard), "while the driver is not heard it is sent stops alone"
    assert bench.machine.state().mode in ("fault", "idle")
    assert max(distance_from(path, position) for position, _ in bench.truth[::5]) <= tolerance
    assert bench.acceleration() <= CEILING * 1.1
    if bench.last().status != "succeeded":
        assert bench.machine.state().mode == "fault"
        speeds = np.array([np.abs(velocity).max() for _, velocity in bench.truth])
        moving = np.flatnonzero(speeds > STILL)
        assert np.all(np.diff(moving) < 20), "the arm came to rest and moved again"
    return bench


@pytest.mark.lengthy
@examples(0.04)
@given(
    case=st.sampled_from(DRIVEN),
    after=st.floats(0.02, 1.8),
    seconds=st.one_of(st.floats(0.2, 1.5), st.floats(1.5, 12.0)),
    rate=st.sampled_from([100.0, 250.0]),
)
def test_a_stall_at_any_moment_leaves_the_arm_on_its_path(
    tmp_path_factory: pytest.TempPathFactory, case: Case, after: float, seconds: float, rate: float
) -> None:
    bench = stalled_for(tmp_path_factory.mktemp("stall"), case, after, seconds, rate)
    bench.machine.reset(arrival())
    where = bench.arm.position
    bench.run(1.0)
    np.testing.assert_allclose(bench.arm.position, where, atol=1e-4)
    bench.execute(HOME, bench.positions[-1])
    bench.until("idle")
    assert bench.last().status == "succeeded"


def command(based_on: float, expires_after: float = 0.1) -> DriverCommand:
    return DriverCommand(
        sequence=1,
        joint_names=("a",),
        based_on=based_on,
        expires_after=expires_after,
        time=(0.0,),
        position=((0.0,),),
    )


def test_a_command_expires_and_a_stop_never_does() -> None:
    expiry = Expiry()
    expiry.report(1000.0, 5.0)
    expiry.report(1000.01, 5.01)
    assert expiry.in_time(command(1000.0), 5.1)
    assert not expiry.in_time(command(1000.0), 5.101)
    assert expiry.in_time(command(1000.005), 5.1), "a stamp of another's counts as the one before it"
    assert not expiry.in_time(command(999.0), 5.02), "of a joint state that nobody told"
    assert expiry.in_time(DriverCommand(sequence=2, joint_names=("a",)), 100.0)
    undated = DriverCommand(sequence=3, joint_names=("a",), time=(0.0,), position=((0.0,),))
    assert not expiry.in_time(undated, 5.02), "it does not say until when"


def test_a_step_of_the_drivers_clock_makes_nothing_late() -> None:
    for step in (-3600.0, 3600.0):
        expiry = Expiry()
        expiry.report(10000.0, 5.0)
        expiry.report(10000.0 + step, 5.01)
        assert expiry.in_time(command(10000.0 + step), 5.1)
        assert not expiry.in_time(command(10000.0 + step), 5.2)
