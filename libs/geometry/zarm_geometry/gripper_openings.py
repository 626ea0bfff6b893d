"""Measured gripper openings, in the form that collision checks need."""

from __future__ import annotations

import threading
from collections.abc import Callable
from contextlib import suppress

from zarm_contract import messages
from zarm_contract.descriptor import RobotDescriptor
from zarm_contract.errors import InvalidRequest, Unavailable
from zarm_contract.messages import GripperOpening, GripperState
from zarm_geometry.robot_model import Openings

_DECIMALS = 3
"""Openings are rounded to 1 mm, so that the noise of a measurement does not make a new model of the robot."""


class GripperOpenings:
    """The openings of a robot's grippers: as published by the executor, and open until then. Thread-safe.

    Calls `changed()` after every change. `ask(name)` asks the executor for the state of a gripper; it raises Unavailable.
    """

    def __init__(
        self,
        descriptor: RobotDescriptor,
        changed: Callable[[], object] = lambda: None,
        ask: Callable[[str], GripperState | None] = lambda _: None,
    ) -> None:
        self._grippers = descriptor.grippers
        self._changed = changed
        self._ask = ask
        self._moving: dict[str, GripperState] = {}
        self._lock = threading.Lock()
        self._openings = {name: gripper.open for name, gripper in self._grippers.items()}

    def receive(self, _key: str, state: GripperState) -> None:
        """Take what the executor publishes."""
        if state.width is None or state.gripper not in self._grippers:
            return
        width = round(state.width, _DECIMALS)
        with self._lock:
            if state.done:
                self._moving.pop(state.gripper, None)
            else:
                self._moving[state.gripper] = state
            if self._openings[state.gripper] == width:
                return
            self._openings = {**self._openings, state.gripper: width}
        self._changed()

    def present(self) -> Openings:
        """The openings now."""
        return tuple(sorted(self._openings.items()))

    def chosen(self, given: messages.Openings) -> Openings:
        """The openings that a request gives, for the other grippers those of now, and for one that moves where its goal leads. Raises
        InvalidRequest.

        That one moves may be old news: a client that has seen it stand may ask before its last state has arrived here.
        """
        for name in [*self._moving]:
            with suppress(Unavailable):
                if (state := self._ask(name)) is not None:
                    self.receive("", state)
        leads = {name: state.target for name, state in self._moving.items() if state.target is not None}
        openings = leads | {opening.gripper: opening.width for opening in given}
        for i, opening in enumerate(given):
            self.named(opening.gripper, f"openings.{i}.gripper")
            self.check(opening.gripper, opening.width, f"openings.{i}.width")
        return tuple((name, round(openings.get(name, width), _DECIMALS)) for name, width in self.present())

    def named(self, name: str | None, field: str) -> str:
        """The gripper of this name, or the only one. Raises InvalidRequest that names the `field`."""
        known = ", ".join(self._grippers) or "none"
        if name is None and len(self._grippers) == 1:
            return known
        if name is None:
            raise InvalidRequest(f"name a gripper; this robot has {known}", field=field)
        if name not in self._grippers:
            raise InvalidRequest(f"there is no gripper {name}; this robot has {known}", field=field)
        return name

    def check(self, name: str, width: float, field: str) -> None:
        """Raise InvalidRequest that names the `field` for a width (m) that a gripper cannot have."""
        gripper = self._grippers[name]
        if not gripper.closed <= width <= gripper.open:
            raise InvalidRequest(
                f"{name} cannot open {width:g} m; give {gripper.closed:g} to {gripper.open:g}", field=field
            )


def openings_of(given: messages.Openings) -> Openings:
    """Openings of a message."""
    return tuple(sorted((opening.gripper, opening.width) for opening in given))


def openings_message(openings: Openings) -> messages.Openings:
    """Openings as a message."""
    return tuple(GripperOpening(gripper=name, width=width) for name, width in openings)
