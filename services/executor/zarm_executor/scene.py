"""The present scene revision, and whether a plan was made for another one."""

from __future__ import annotations

import threading
from collections.abc import Callable

from zarm_contract.errors import ExecutionRefused, Unavailable
from zarm_contract.messages import SceneEdited, SceneRevision
from zarm_executor.machine import Machine


class PresentScene:
    """The revision of the planner's scene, which the machine is told, too. Safe from any thread.

    A client may have edited the scene and ask for a motion before the publication of that is read here. So `ask` asks the
    planner; it raises Unavailable where none answers, and then what was told last counts.
    """

    def __init__(self, machine: Machine, ask: Callable[[], SceneEdited]) -> None:
        self._machine = machine
        self._ask = ask
        self._telling = threading.Lock()

    def hear(self, _key: str, scene: SceneEdited) -> None:
        """Note what the planner publishes."""
        with self._telling:
            self._machine.scene = scene.revision

    def look(self) -> SceneRevision | None:
        """The present revision; None if nobody answers, nor has ever told one."""
        before = self._machine.scene
        try:
            answer = self._ask().revision
        except Unavailable:
            return self._machine.scene
        with self._telling:
            if self._machine.scene == before:  # else a publication that came meanwhile may be newer
                self._machine.scene = answer
        return answer

    def demand(self, what: str, verified_in: SceneRevision | None) -> SceneRevision | None:
        """The present revision. Raises ExecutionRefused (`stale_plan`) unless it is that in which `what` was verified.

        Raises Unavailable if nobody has told one. `what` that claims none, None, holds in any.
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
