"""Attaches and detaches what programs say, when the robot gets there."""

from __future__ import annotations

import logging
import threading
from collections import OrderedDict
from collections.abc import Callable, Sequence

from zarm_contract.errors import ZarmError
from zarm_contract.messages import GoalState, SceneEdit, SceneEdited
from zarm_planner.programs import ChangeAt

log = logging.getLogger(__name__)

_PROGRAMS_KEPT = 32
"""Programs whose changes are known; the executor remembers as many plans."""


class ProgramChanges:
    """The changes of the latest programs. `edit` changes the scene. Thread-safe."""

    def __init__(self, edit: Callable[[SceneEdit], SceneEdited]) -> None:
        self._edit = edit
        self._programs: OrderedDict[str, tuple[float, tuple[ChangeAt, ...]]] = OrderedDict()
        # How many changes each goal has made: its last state may arrive again, and must change nothing then.
        self._made: OrderedDict[str, int] = OrderedDict()
        self._lock = threading.Lock()

    def remember(self, plan_id: str, duration: float, changes: Sequence[ChangeAt]) -> None:
        """Note what the program of a plan, which lasts `duration` s, attaches and detaches."""
        if not changes:
            return
        with self._lock:
            self._programs[plan_id] = duration, tuple(changes)
            if len(self._programs) > _PROGRAMS_KEPT:
                self._programs.popitem(last=False)

    def receive(self, _key: str, goal: GoalState) -> None:
        """Make the changes that a goal has come to; one that was replanned makes none."""
        with self._lock:
            duration, changes = self._programs.get(goal.plan_id or "", (0.0, ()))
            if abs(goal.duration - duration) > 1e-6:
                return
            made = self._made.get(goal.goal_id, 0)
            due = [change for at, change in changes if at <= goal.progress * duration + 1e-6][made:]
            self._made[goal.goal_id] = made + len(due)
            if len(self._made) > _PROGRAMS_KEPT:
                self._made.popitem(last=False)
            for change in due:
                try:
                    self._edit(SceneEdit(edit=change))
                except ZarmError as error:
                    log.error("scene not changed goal=%s object=%s reason=%s", goal.goal_id, change.name, error)
