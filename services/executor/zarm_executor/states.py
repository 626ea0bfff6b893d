"""The states of a goal, and the mode of the robot and the status of the goal that follow from each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from zarm_contract.descriptor import FaultPolicy
from zarm_contract.errors import ExecutionFailed, Problem
from zarm_contract.messages import GoalStatus, Hold, RobotMode
from zarm_executor.monitor import NotStopped


@dataclass(frozen=True)
class Outcome:
    """How a goal ends. After a robot `fault` nothing moves until the fault is left; a `latched` fault can only be left
    by `reset`.
    """

    status: GoalStatus
    problem: Problem | None = None
    fault: bool = False
    latched: bool = False

    @classmethod
    def fault_of(cls, failures: Sequence[ExecutionFailed], policy: FaultPolicy) -> Outcome:
        """The outcome of failed checks during motion or in the control loop, in order; its problem says how to leave
        the fault.
        """
        latched = policy == "latch" or any(isinstance(failure, NotStopped) for failure in failures)
        found = "; and ".join(failure.problem.message for failure in failures)
        way_out = (
            ", then reset (executor/reset)"
            if latched
            else "; the next goal leaves this fault, once the robot rests and reports its joints"
        )
        problem = failures[0].problem.model_copy(update={"message": found + way_out})
        return cls("aborted", problem, fault=True, latched=latched)


@dataclass(frozen=True)
class Accepted:
    """The goal has not reached the control loop yet."""


@dataclass(frozen=True)
class Running:
    """The robot moves along the trajectory."""


@dataclass(frozen=True)
class Held:
    """The robot brakes, or waits `at_rest`, for `hold`, since `since` (s, monotonic); it goes on by itself once its
    authority reaches beyond the path time `at` (s).
    """

    hold: Hold
    since: float
    at: float
    at_rest: bool = False


@dataclass(frozen=True)
class Pausing:
    """The robot brakes for a pause. `held` is the reason why the goal will still be held once it resumes."""

    held: Held | None


@dataclass(frozen=True)
class Paused:
    """The robot rests and keeps its goal. `held` is as in Pausing."""

    held: Held | None


@dataclass(frozen=True)
class Ending:
    """The robot brakes, and then the goal ends with `outcome`. `held` is why it was held before."""

    outcome: Outcome
    held: Held | None


@dataclass(frozen=True)
class Ended:
    """The robot is at rest, and the goal has ended."""

    outcome: Outcome


State = Accepted | Running | Held | Pausing | Paused | Ending | Ended
"""Exactly one of them holds for a goal."""


def status_of(state: State) -> GoalStatus:
    """The status that is published for a goal in this state."""
    match state:
        case Accepted():
            return "accepted"
        case Running() | Held() | Pausing():
            return "running"
        case Paused():
            return "paused"
        case Ending():
            return "stopping"
        case Ended(outcome):
            return outcome.status


def mode_of(state: State) -> RobotMode:
    """The mode of a robot with a goal in this state."""
    match state:
        case Accepted() | Running() | Held():
            return "running"
        case Paused():
            return "paused"
        case Pausing() | Ending() | Ended():
            return "stopping"


def held_of(state: State) -> Held | None:
    """Why a goal in this state is held, apart from a pause."""
    if isinstance(state, Held):
        return state
    return state.held if isinstance(state, (Pausing, Paused, Ending)) else None


def hold_of(state: State) -> Hold | None:
    """The hold that is published for a goal in this state."""
    held = held_of(state)
    return held.hold if held is not None else None


def outcome_of(state: State) -> Outcome | None:
    """The outcome, once it is certain."""
    return state.outcome if isinstance(state, (Ending, Ended)) else None


def with_held(state: State, held: Held | None) -> State:
    """The same state of a goal that is held for another reason, or for none."""
    match state:
        case Pausing():
            return Pausing(held)
        case Paused():
            return Paused(held)
        case Ending(outcome, _):
            return Ending(outcome, held)
        case _:
            return held if held is not None else Running()
