"""Objects that come at the arm at up to their stated speed, whatever it does: it never moves into one."""

from __future__ import annotations

import pytest

from support.servo.adversary import MODES, Cell, Mode


@pytest.fixture(scope="module")
def cell() -> Cell:
    return Cell()


@pytest.mark.lengthy
@pytest.mark.parametrize(
    "mode",
    [pytest.param(mode, marks=pytest.mark.xdist_group(mode)) for mode in MODES],  # at once
)
@pytest.mark.parametrize(
    "first", [pytest.param(first, marks=[pytest.mark.slow] * (first >= 34)) for first in range(0, 340, 17)]
)
def test_a_robot_never_moves_into_what_comes_at_it(cell: Cell, mode: Mode, first: int) -> None:
    attacks = {seed: cell.attack(seed, mode) for seed in range(first, first + 17)}
    assert [seed for seed, attack in attacks.items() if attack.outcome == "contact"] == []
    assert any(attack.moved for attack in attacks.values())


@pytest.mark.parametrize(
    ("mode", "seeds"), [("session", (1010, 1014, 1020, 1025, 1032)), ("chunks", (1010, 1014, 1015))]
)
def test_an_arm_that_is_late_is_stopped_earlier(cell: Cell, mode: Mode, seeds: tuple[int, ...]) -> None:
    attacks = {seed: cell.attack(seed, mode, lag=0.1) for seed in seeds}
    assert [seed for seed, attack in attacks.items() if attack.outcome == "contact"] == []
    assert all(attack.moved for attack in attacks.values())
