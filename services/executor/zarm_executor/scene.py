"""The present scene revision, and whether a plan was made for another one."""

from __future__ import annotations

import threading
from collections.abc import Callable

from zarm_contract.errors import ExecutionRefused, Unavailable
from zarm_contract.messages import SceneEdited, SceneRevision
from zarm_executor.machine import Machine


class PresentScene:
    """The revision of the planner's scene, passed on to the machine. Thread-safe.

    A client may edit the scene and request a motion before the edit's publication is received here. So `ask` asks the
    planner; it raises Unavailable if none answers, and then the last known revision counts.
    """

    def __init__(self, machine: Machine, ask: Callable[[], SceneEdited]) -> None:
        self._machine = machine
        self._ask = ask
        self._telling = threading.Lock()

    def receive(self, _key: str, scene: SceneEdited) -> None:
        """Note what the planner publishes."""
        with self._telling:
            self._machine.scene = scene.revision

    def look(self) -> SceneRevision | None:
        """The present revision; None if nobody answers and none was ever published."""
        before = self._machine.scene
        try:
            answer = self._ask().revision
        except Unavailable:
            return self._machine.scene
        with self._telling:
            if self._machine.scene == before:  # otherwise a newer publication may have arrived meanwhile
                self._machine.scene = answer
        return answer

    def demand(self, what: str, verified_in: SceneRevision | None) -> SceneRevision | None:
        """The present revision. Raises ExecutionRefused (`stale_plan`) unless `what` was verified in it.

        Raises Unavailable if no revision is known. If `verified_in` is None, `what` claims no scene and is accepted in
        any.
        """
        present = self.look()
        if verified_in in (None, present):
            return present
        if present is None:
            raise Unavailable(
                f"{what} was verified in revision {verified_in} of the scene, and the present revision is not known yet; "
                "start the planner, then execute again"
            )
        raise ExecutionRefused(
            f"{what} was verified in revision {verified_in} of the scene, which is at {present} now; plan again",
            code="stale_plan",
        )
