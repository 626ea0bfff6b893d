"""What a goal waits for that its executor holds, in a sentence."""

from __future__ import annotations

from zarm_contract.messages import Hold


def waits_for(hold: Hold) -> str:
    """Why the goal is held, without a full stop."""
    found = hold.obstruction
    if hold.reason == "no_guard":
        return "no servo is heard, and this robot moves under one alone (execution.guard); start the servo"
    if found is None:
        return "something is in its way"
    return f"{found.object} is in the way of {found.link}"
