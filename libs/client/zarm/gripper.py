"""The grippers of a robot: they open, close, and hold what is between their pads."""

from __future__ import annotations

import time
from collections.abc import Callable, Generator, Mapping
from contextlib import suppress
from typing import TypedDict, Unpack

from zarm.calls import Calls
from zarm.live import live
from zarm.values import made
from zarm_contract.errors import Cancelled, InvalidRequest, Unavailable, from_problem
from zarm_contract.messages import GripperCancel, GripperRequest, GripperState

SILENCE = 10.0
"""s without news of a moving gripper after which its executor counts as gone."""

OnProgress = Callable[[GripperState], object]


class GripperOptions(TypedDict, total=False):
    """Options of a motion of a gripper: `force` (N) and `speed` (m/s), by default the greatest; whether it may `preempt` the goal that moves
    the gripper now; and `on_progress`, which gets each state. Those that are left out, or None, are the defaults.
    """

    force: float | None
    speed: float | None
    preempt: bool
    on_progress: OnProgress | None


class Gripper(Calls):
    """Commands to the grippers of a robot, and their states. `gripper` names one; a robot's only one needs no name."""

    def open(self, gripper: str | None = None, **options: Unpack[GripperOptions]) -> GripperState:
        """Open a gripper as far as it goes; otherwise as `move`."""
        return self.move(self.state(gripper).widths[1], gripper, **options)

    def close(self, gripper: str | None = None, **options: Unpack[GripperOptions]) -> GripperState:
        """Close a gripper until it is closed or something stops the fingers; otherwise as `move`."""
        return self.move(self.state(gripper).widths[0], gripper, **options)

    def move(self, width: float, gripper: str | None = None, **options: Unpack[GripperOptions]) -> GripperState:
        """Move a gripper until it is `width` m open, and wait until the fingers stand. Returns its state: `reached`, or
        `stalled` if something stops them before, usually what they hold.

        `options` are `force`, `speed`, `preempt` and `on_progress`: see `zarm.GripperOptions`. Ctrl-C stops the fingers where they are.

        Raises InvalidRequest for a gripper that is not there or a width out of its range, Busy while it moves for another goal,
        ExecutionFailed if it does not move, and Cancelled if another client stopped it.
        """
        fields: dict[str, object] = {**options}
        on_progress = options.get("on_progress")
        fields.pop("on_progress", None)
        request = made(GripperRequest, gripper=gripper, width=width, **fields)
        try:
            goal_id = self._ask(self._keys.gripper, request).goal_id
        except (Unavailable, KeyboardInterrupt):  # the executor may have received the request
            self._stop(gripper)
            raise
        try:
            last = self._followed(goal_id, gripper, on_progress)
        except BaseException:
            self._stop(gripper)
            raise
        if last.goal_id != goal_id:
            raise Cancelled(f"{last.goal_id} took the place of this goal of {last.gripper}")
        if last.problem is not None:
            raise from_problem(last.problem)
        return last

    def cancel(self, gripper: str | None = None) -> GripperState:
        """Stop a gripper where it is; what it holds, it goes on holding."""
        return self._ask(self._keys.gripper_cancel, made(GripperCancel, gripper=gripper))

    def all(self) -> Mapping[str, GripperState]:
        """The present state of each gripper by name."""
        found: dict[str, GripperState] = {}

        def read() -> None:
            self.connection.bus.watch(
                self._keys.gripper_state("*"), lambda _, state: found.update({state.gripper: state})
            )()

        self.connection.interrupts.run_interruptibly(read)
        return found

    def state(self, gripper: str | None = None) -> GripperState:
        """The present state of a gripper. Raises InvalidRequest for one that is not there, or if none of several is named."""
        found = self.all()
        if not found:
            self.connection.read(self._keys.executor_state)  # raises if it is the executor that is missing
            raise InvalidRequest(
                f"{self.name} has no gripper; describe it in `grippers` of its descriptor", field="gripper"
            )
        if gripper is None and len(found) > 1:
            raise InvalidRequest(f"{self.name} has several grippers, {', '.join(found)}; name one", field="gripper")
        if gripper is not None and gripper not in found:
            raise InvalidRequest(f"{self.name} has no gripper {gripper}, but {', '.join(found)}", field="gripper")
        return next(iter(found.values())) if gripper is None else found[gripper]

    def states(self, gripper: str | None = None) -> Generator[GripperState]:
        """The present state of a gripper, then every change; endless."""
        return self.connection.latched(self._keys.gripper_state(gripper or "*"))

    def _stop(self, gripper: str | None) -> None:
        with suppress(Unavailable):
            self.cancel(gripper)

    def _followed(self, goal_id: str, gripper: str | None, on_progress: OnProgress | None) -> GripperState:
        reported_at = time.monotonic()

        def check() -> None:
            self.connection.bus.check_open()
            if time.monotonic() - reported_at > SILENCE:
                raise Unavailable(
                    f"the executor of {self.name} has reported nothing about the gripper for {SILENCE:g} s; see `zarm status`"
                )

        def subscribe(emit: Callable[[GripperState], None]) -> Callable[[], None]:
            bus, key = self.connection.bus, self._keys.gripper_state(gripper or "*")
            return self.connection.interrupts.run_interruptibly(lambda: bus.watch(key, lambda _, state: emit(state)))

        for state in live(subscribe, self.connection.interrupts, check):
            reported_at = time.monotonic()
            if state.goal_id == goal_id and on_progress is not None:
                on_progress(state)
            if state.goal_id != goal_id or state.done:
                break
        return state
