"""The required outcome of every fault, checked in one way: rest within a bound, gentle braking, a reason, and recovery."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from support.executor.driven import LIMIT
from support.faults.arena import STEP, Arena
from support.harness import eventually
from support.trajectories import HOME
from zarm_contract.errors import Problem
from zarm_contract.messages import GoalState
from zarm_simulated_driver.player import CEILING

IN_MOTION = 0.5
"""Speed of the fastest joint, rad/s, at which the fault is injected."""
LATEST = 0.9
"""s into its motion of 2.4 s: injected later, it misses its end by less than `path_tolerance`, which is not a fault."""
TRIES = 10
STILL = 1e-3
"""Slower than this (rad/s) counts as at rest, because of the drives' lag."""
WATCHED = 30
"""Steps of the arm for which nothing may move after the recovery, and again after the reset."""
WINDOW = 10
"""Steps of the arm over which its acceleration is taken: five points of a command."""
ONE_POINT = 1 / 5
"""Share by which a chunk that begins one point off may exceed that, because executor and driver tick independently."""

Fault = Callable[[Arena], Iterator[str | None]]
"""Starts a motion and yields its goal; when the arm moves, injects the fault, and yields; when the arm stands,
recovers.
"""


@dataclass(frozen=True)
class Promise:
    """The outcome of a fault under one strategy: rest within `bound` s, for the reason `why`.

    The goal then ends with the problem `code`, whose message contains `says`; without both it succeeds.
    """

    bound: float
    why: str
    code: str | None = None
    says: str = ""


@dataclass(frozen=True)
class Figure:
    """The measurement: s from the fault to rest, and rad/s^2 on the way."""

    rest: float
    acceleration: float


def endure(place: Arena, fault: Fault, promise: Promise) -> Figure:
    """Inject a fault and check everything that is promised."""
    place.warm_up()
    burden = place.burden()
    steps, goal_id = begun(place, fault)
    struck = place.samples()
    next(steps)
    place.wait_to_stand()
    assert next(steps, None) is None

    ended = reason(place, goal_id)
    if promise.code is None:
        assert ended is None, ended
    else:
        assert ended is not None
        assert ended.code == promise.code, ended
        assert promise.says in ended.message, ended
    nothing_moves(place)
    assert place.client.command(place.keys.reset).mode == "idle"
    nothing_moves(place)
    figure = measured(place, struck)
    place.nudge()
    eventually(lambda: np.all(np.array(place.burden()) <= burden), f"the executor is back at {burden} threads, files")
    assert figure.rest <= promise.bound, figure
    assert figure.acceleration <= CEILING * (1 + ONE_POINT), figure
    assert place.commanded_acceleration() <= LIMIT * 1.01
    return figure


def begun(place: Arena, fault: Fault) -> tuple[Iterator[str | None], str]:
    """The fault about to be injected during the motion of an arm, and the goal; another motion if a busy machine missed
    one.
    """
    for _ in range(TRIES):
        stood, steps = place.samples(), fault(place)
        goal_id = next(steps)
        assert goal_id is not None

        def over(goal_id: str = goal_id) -> list[GoalState]:
            return [goal for goal in place.client.goals if goal.goal_id == goal_id and goal.done]

        eventually(lambda over=over: over() or place.speed() > IN_MOTION, "the arm is in motion")  # type: ignore[misc]
        moving = np.abs(place.trace()[stood:, len(HOME) :]).max(axis=1) > STILL
        if np.count_nonzero(moving) * STEP <= LATEST and not over():
            return steps, goal_id
        end = place.client.ended(goal_id)
        assert end.status == "succeeded", end
        place.wait_to_stand()
    raise AssertionError(f"this machine is too busy to strike within {LATEST:g} s of a motion's beginning")


def reason(place: Arena, goal_id: str) -> Problem | None:
    """Why the goal ended, which the executor's state must repeat if it is in fault; None if it succeeded."""
    place.heard()
    goal = place.client.ended(goal_id)
    state = place.heard()
    assert (goal.status == "succeeded") == (goal.problem is None), goal
    if state.mode == "fault":
        assert state.problem == goal.problem
    else:
        assert state.mode == "idle"
    return goal.problem


def nothing_moves(place: Arena) -> None:
    """Wait for some more steps of the arm."""
    seen = place.samples()
    eventually(lambda: place.samples() >= seen + WATCHED, "the arm goes on")
    assert place.stands_for(WATCHED)


def measured(place: Arena, struck: int) -> Figure:
    """From the step of the fault to the last step at which the arm moved."""
    velocity = place.trace()[struck - WINDOW :, len(HOME) :]
    moving = np.flatnonzero(np.abs(velocity).max(axis=1) > STILL)
    change = np.abs(velocity[WINDOW:] - velocity[:-WINDOW]) / (WINDOW * STEP)
    return Figure((moving[-1] + 1 - WINDOW) * STEP, float(change.max()))
