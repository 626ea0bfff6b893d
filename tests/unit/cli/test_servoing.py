"""`zarm track` says what limits the robot: each state that lasts, and no line for one that flickers."""

from __future__ import annotations

from collections.abc import Iterable

from zarm_cli.servoing import Shown

PERIOD = 0.05


def lines(states: Iterable[str]) -> list[str]:
    """What is shown of states that come every PERIOD s."""
    shown = Shown()
    return [state for number, state in enumerate(states) if shown.changes(state, number * PERIOD)]


def test_a_state_that_lasts_is_shown_once() -> None:
    assert lines(["free"] * 10 + ["slowing by wall"] * 10 + ["blocked by wall"] * 10) == [
        "free",
        "slowing by wall",
        "blocked by wall",
    ]


def test_two_states_that_alternate_are_one_line() -> None:
    assert lines(["slowing by wall"] * 10 + ["blocked by wall", "slowing by wall"] * 50) == ["slowing by wall"]


def test_a_change_to_states_that_alternate_is_shown() -> None:
    first, *others = lines(["free"] * 10 + ["blocked by wall", "slowing by wall"] * 50)
    assert first == "free"
    assert len(others) == 1


def test_a_change_that_is_interrupted_is_shown() -> None:
    assert lines(["slowing by wall"] * 10 + (["blocked by wall"] * 4 + ["slowing by wall"]) * 5) == [
        "slowing by wall",
        "blocked by wall",
    ]


def test_a_state_that_passes_is_not_shown() -> None:
    assert lines(["free"] * 10 + ["singularity"] * 3 + ["free"] * 10) == ["free"]
