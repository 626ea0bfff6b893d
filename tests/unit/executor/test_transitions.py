"""The modes seen under random commands and faults are those of the table, and every arrow of the table is seen."""

from __future__ import annotations

import random
from collections.abc import Callable

import pytest

from support.arrivals import arrival
from support.executor.bench import Arm, Bench
from zarm_contract.errors import Unavailable, ZarmError
from zarm_contract.messages import RobotMode
from zarm_executor.transitions import MODES, TRANSITIONS

ARROWS = {(arrow.before, arrow.after) for arrow in TRANSITIONS}


def modes_of(seed: int) -> list[RobotMode]:
    """The modes of a robot after each of some hundred random commands, faults and periods."""
    chance, bench = random.Random(seed), Bench()
    machine, goals = bench.machine, iter(range(10_000))
    modes: list[RobotMode] = []

    def fault() -> None:
        bench.arm.disturb = lambda _: None

    def broken_switch() -> None:
        other = Arm()
        other.failure = bench.arm.failure = Unavailable("no driver")
        machine.switch(other, 0.0, arrival())

    def mended() -> None:
        bench.arm.failure = None
        bench.arm.disturb = lambda measured: measured
        machine.reset(arrival())

    commands: list[Callable[[], object]] = [
        lambda: bench.execute(f"goal-{next(goals)}"),
        lambda: bench.execute(f"goal-{next(goals)}"),
        lambda: machine.pause(arrival()),
        lambda: machine.resume(arrival()),
        lambda: machine.resume(arrival()),
        lambda: machine.cancel(None, "enough", arrival()),
        lambda: machine.stop("enough", arrival()),
        fault,
        broken_switch,
        mended,
    ]
    for _ in range(60):
        try:
            chance.choice(commands)()
        except ZarmError:
            pass
        modes.append(machine.state().mode)
        for _ in range(chance.choice((1, 5, 40, 300))):
            bench.tick()
            modes.append(machine.state().mode)
    return modes


@pytest.mark.parametrize("seed", range(20))
def test_no_mode_follows_another_but_along_an_arrow(seed: int) -> None:
    modes = modes_of(seed)
    assert {*zip(modes, modes[1:])} - {(mode, mode) for mode in MODES} <= ARROWS


def test_every_arrow_is_seen() -> None:
    seen = {pair for seed in range(20) for modes in (modes_of(seed),) for pair in zip(modes, modes[1:])}
    assert seen >= ARROWS
