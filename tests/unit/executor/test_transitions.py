"""The modes seen under random commands and faults are those of the table, and every arrow of the table is seen."""

from __future__ import annotations

import random
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from itertools import count, pairwise

import pytest

from support.arrivals import arrival
from support.executor.bench import Arm, Bench
from support.trajectories import ROBOT
from zarm_contract.errors import Unavailable, ZarmError
from zarm_contract.messages import Authority, Obstruction, RobotMode
from zarm_executor.transitions import MODES, TRANSITIONS

ARROWS = {(arrow.before, arrow.after) for arrow in TRANSITIONS}


CLEARING = ROBOT.descriptor.model_copy(
    update={"execution": ROBOT.descriptor.execution.model_copy(update={"faults": "clear_at_rest"})}
)


def modes_of(seed: int) -> list[RobotMode]:
    """The modes of a robot after each of some hundred random commands, faults and periods."""
    chance, bench = random.Random(seed), Bench(robot=CLEARING if seed % 2 else ROBOT.descriptor)
    machine, goals, authorities = bench.machine, count(), count(1)
    modes: list[RobotMode] = []

    def pause_for_a_moment() -> None:
        machine.pause(arrival())
        bench.tick()
        modes.append(machine.state().mode)
        machine.resume(arrival())

    def unseen() -> None:
        bench.arm.disturb = lambda _: None

    def pushed() -> None:
        bench.arm.disturb = lambda measured: replace(measured, position=measured.position + 0.5)

    def held() -> None:
        if (goal := machine.goal_state()) is not None:
            until = bench.arm.follower.time + 0.1
            machine.receive(
                Authority(
                    servo="servo",
                    sequence=next(authorities),
                    goal_id=goal.goal_id,
                    trajectory=1,
                    scene_revision=None,
                    until=until,
                    obstruction=Obstruction(object="box", link="link_6", time=until),
                ),
                bench.now,
            )

    def broken_switch() -> None:
        other = Arm()
        other.failure = bench.arm.failure = Unavailable("no driver")
        machine.switch(other, 0.0, arrival())

    def mended() -> None:
        bench.arm.failure = None
        bench.arm.disturb = lambda measured: measured
        machine.reset(arrival())

    def seen_again() -> None:
        bench.arm.disturb = lambda measured: measured

    commands: list[Callable[[], object]] = [
        lambda: bench.execute(f"goal-{next(goals)}"),
        lambda: bench.execute(f"goal-{next(goals)}"),
        lambda: machine.pause(arrival()),
        lambda: machine.pause(arrival()),
        lambda: machine.resume(arrival()),
        lambda: machine.resume(arrival()),
        lambda: machine.cancel(None, "enough", arrival()),
        lambda: machine.stop("enough", arrival()),
        pause_for_a_moment,
        held,
        held,
        unseen,
        pushed,
        seen_again,
        seen_again,
        broken_switch,
        mended,
        mended,
    ]
    for _ in range(100):
        with suppress(ZarmError):
            chance.choice(commands)()
        modes.append(machine.state().mode)
        for _ in range(chance.choice((1, 5, 40, 300))):
            bench.tick()
            modes.append(machine.state().mode)
    return modes


@pytest.mark.parametrize("seed", range(20))
def test_no_mode_follows_another_but_along_an_arrow(seed: int) -> None:
    modes = modes_of(seed)
    assert {*pairwise(modes)} - {(mode, mode) for mode in MODES} <= ARROWS


def test_every_arrow_is_seen() -> None:
    seen = {pair for seed in range(20) for modes in (modes_of(seed),) for pair in pairwise(modes)}
    assert ARROWS - seen == set()
