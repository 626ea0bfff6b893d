"""The goals of an executor, as it publishes them."""

from __future__ import annotations

import threading
import time
from collections import OrderedDict
from collections.abc import Iterator

from zarm.interrupts import SLICE, Interrupts
from zarm_contract.errors import Unavailable, ZarmError
from zarm_contract.keys import Keys
from zarm_contract.messages import GoalState
from zarm_runtime.bus import Bus

SILENCE = 10.0
"""s without news of a goal after which its executor counts as gone; one that restarts reports the goal's end within
that time.
"""
_ASK_AFTER = 0.5  # s without a publication after which the executor is asked; in motion it publishes at 10 Hz
_ASK_SECONDS = 1.0
_GOALS_KEPT = 64


class Goals:
    """The published states of an executor's goals. Thread-safe."""

    def __init__(self, bus: Bus, keys: Keys) -> None:
        self._bus = bus
        self._keys = keys
        self._states: OrderedDict[str, GoalState] = OrderedDict()
        self._changed = threading.Condition()
        self._listening = threading.Lock()
        self._subscribed = False

    def listen(self) -> None:
        """From now on miss no state; states of goals that have not ended are read first."""
        self._bus.check_open()
        with self._listening:
            if not self._subscribed:
                self._bus.watch(self._keys.goal("*"), lambda _, state: self._note(state))
                self._subscribed = True

    def known(self, goal_id: str) -> GoalState | None:
        """The last known state of a goal."""
        with self._changed:
            return self._states.get(goal_id)

    def states(
        self, goal_id: str, interrupts: Interrupts, *, silence: float = SILENCE, timeout: float | None = None
    ) -> Iterator[GoalState]:
        """The goal's states up to its last one; if there is no new one, the same again ten times a second.

        Raises Unavailable if the executor has been silent for `silence` s, or the goal has not ended after `timeout` s.
        """
        interrupts.run_interruptibly(self.listen)
        seen: GoalState | None = None
        began = reported_at = asked = time.monotonic()
        while seen is None or not seen.done:
            interrupts.check()
            self._bus.check_open()
            state = self._next(goal_id, seen)
            now = time.monotonic()
            if state is not seen:
                seen, reported_at = state, now
            elif now - reported_at > silence:
                raise self._unknown(f"has reported nothing about the goal {goal_id} for {silence:g} s")
            elif now - max(reported_at, asked) > _ASK_AFTER:
                interrupts.run_interruptibly(lambda: self._ask(goal_id))
                asked = time.monotonic()
            if timeout is not None and now - began > timeout and not (seen is not None and seen.done):
                raise self._unknown(f"has not ended the goal {goal_id} within {timeout:g} s")
            if seen is not None:
                yield seen

    def _unknown(self, why: str) -> Unavailable:
        return Unavailable(
            f"the executor of {self._keys.robot} {why}; it is unknown whether the robot still moves: make sure that it stands "
            "still, then see `zarm status`"
        )

    def _next(self, goal_id: str, seen: GoalState | None) -> GoalState | None:
        with self._changed:
            self._changed.wait_for(lambda: self._states.get(goal_id, seen) is not seen, SLICE)
            return self._states.get(goal_id, seen)

    def _ask(self, goal_id: str) -> None:
        try:
            state = self._bus.read(self._keys.goal(goal_id), timeout=_ASK_SECONDS)
        except ZarmError:
            return  # it may be restarting; after the silence it is given up
        self._note(state)

    def _note(self, state: GoalState) -> None:
        with self._changed:
            known = self._states.get(state.goal_id)
            if known is not None and known.done:  # this answer was overtaken by the last publication
                return
            self._states[state.goal_id] = state
            self._states.move_to_end(state.goal_id)
            if len(self._states) > _GOALS_KEPT:
                self._states.popitem(last=False)
            self._changed.notify_all()
