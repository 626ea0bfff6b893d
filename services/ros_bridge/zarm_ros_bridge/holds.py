"""Describes in a sentence what a held goal waits for."""

from __future__ import annotations

from zarm_contract.messages import GoalState, Hold


def waiting(goal: GoalState | None) -> str | None:
    """What this goal waits for, without a full stop; None if there is none, or it is not held."""
    return None if goal is None or goal.hold is None else f"the goal waits: {_reason(goal.hold)}"


def _reason(hold: Hold) -> str:
    found = hold.obstruction
    if hold.reason == "gripper":
        return "its gripper moves"
    if hold.reason == "output":
        return "an output is being switched"
    if hold.reason == "no_guard":
        return "no servo is heard, and this robot moves under one alone (execution.guard); start the servo"
    if found is None:
        return "something is in its way"
    return f"{found.object} is in the way of {found.link}"
