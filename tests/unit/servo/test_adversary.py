"""Objects that come at the arm at up to their stated speed, whatever it does: it never moves into one."""

from __future__ import annotations

import pytest

from support.servo.adversary import MODES, Cell, Mode


@pytest.fixture(scope="module")
def cell() -> Cell:
    return Cell()


each_mode = pytest.mark.parametrize(
    "mode",
    [pytest.param(mode, marks=pytest.mark.xdist_group(mode)) for mode in MODES],  # at once
)


@pytest.mark.lengthy
@each_mode
@pytest.mark.parametrize("first", range(0, 50, 25))
def test_a_robot_never_moves_into_what_comes_at_it(cell: Cell, mode: Mode, first: int) -> None:
    _attack(cell, mode, range(first, first + 25))


@pytest.mark.slow
@each_mode
@pytest.mark.parametrize("first", range(50, 500, 50))
def test_however_it_comes(cell: Cell, mode: Mode, first: int) -> None:
    _attack(cell, mode, range(first, first + 50))


def _attack(cell: Cell, mode: Mode, seeds: range) -> None:
    attacks = {seed: cell.attack(seed, mode) for seed in seeds}
    assert [seed for seed, attack in attacks.items() if attack.outcome == "contact"] == []
    assert any(attack.moved for attack in attacks.values())
