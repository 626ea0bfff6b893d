"""The jog panel: hold buttons or keys, or drag the gizmo."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from itertools import chain
from typing import Any, Literal

from viser import ClientHandle, GuiButtonHandle
from viser.transforms import SE3

from zarm.servoing import Jogging, Tracking
from zarm.values import pose_of
from zarm_viewer.aim import Goal
from zarm_viewer.jogger import Jogger
from zarm_viewer.kinematics import message_of
from zarm_viewer.panel_context import PanelContext
from zarm_viewer.style import PAIRED

LINEAR, ANGULAR, JOINT = 0.15, 0.6, 0.4
"""Speeds (m/s, rad/s, rad/s) at scale 1."""
RATE = 20.0
"""Request rate (Hz) of a page while a button is held."""
KEY_HOLD = 0.3
"""How long (s) a key press counts: until the browser repeats it."""
_AXES = ("x", "y", "z", "rx", "ry", "rz")
_, _TOOL, _JOINTS = _WAYS = ("tip, axes of the base", "tip, axes of the tool", "joints")
_KEYS = {"I": (0, 1), "K": (0, -1), "J": (1, 1), "L": (1, -1), "U": (2, 1), "O": (2, -1)}
"""The axis and direction of each key. Arrows, and the letters around W, A, S and D, turn viser's camera."""


class JogPanel:
    """What is jogged, and how fast; the status above says what limits it."""

    def __init__(self, panels: PanelContext, goal: Goal) -> None:
        self._panels, self._goal = panels, goal
        self._jogger = Jogger(panels)
        gui = panels.server.gui
        gui.add_markdown("Hold a button, or Shift with I/K (x), J/L (y) or U/O (z); let go to stop.")
        self._way = gui.add_dropdown("jog", _WAYS)
        self._scale = gui.add_slider("jog speed", 0.05, 1.0, 0.05, 0.3)
        self._tip = [self._pair(axis, partial(self._twist, axis=at)) for at, axis in enumerate(_AXES)]
        self._joints = [
            self._pair(joint, partial(self._joint, joint=joint)) for joint in panels.description.descriptor.joints
        ]
        self._way.on_update(lambda _: self._choose())
        self._choose()
        self._lead = gui.add_checkbox(
            "the robot follows the handle", False, hint="It moves while the handle is dragged."
        )
        goal.dragged = self._dragged
        self._keys = []
        for key, (axis, sign) in _KEYS.items():
            command = gui.add_command(f"Jog {'+' if sign > 0 else '-'}{_AXES[axis]}", hotkey=key, modifier="shift")  # type: ignore[arg-type]
            command.on_trigger(self._asks(partial(self._twist, axis=axis, sign=sign, hold=KEY_HOLD)))
            self._keys.append(command)

    def chosen(self, yes: bool) -> None:
        """Take keys, or leave them to another robot."""
        for command in self._keys:
            command.disabled = not yes

    def _choose(self) -> None:
        """Show the buttons for the chosen kind of jog."""
        for pairs, seen in ((self._tip, self._way.value != _JOINTS), (self._joints, self._way.value == _JOINTS)):
            for button in chain.from_iterable(pairs):
                button.visible = seen

    def _pair(self, label: str, jog: Callable[..., None]) -> tuple[GuiButtonHandle, GuiButtonHandle]:
        """Buttons that `jog` while held: down and up."""
        down, up = (self._panels.server.gui.add_button(f"{sign} {label}", color=PAIRED) for sign in "−+")
        down.on_hold(self._asks(partial(jog, sign=-1)), callback_hz=RATE)
        up.on_hold(self._asks(partial(jog, sign=1)), callback_hz=RATE)
        return down, up

    def _asks(self, jog: Callable[..., None]) -> Any:
        async def ask(event: Any) -> None:  # in the server's own loop, which keeps requests in order
            jog(event.client)

        return ask

    def _twist(self, client: ClientHandle | None, axis: int, sign: int, **hold: float) -> None:
        vectors = [[0.0] * 3, [0.0] * 3]
        vectors[axis // 3][axis % 3] = sign * self._scale.value * (LINEAR if axis < 3 else ANGULAR)
        frame: Literal["base", "tool"] = "tool" if self._way.value == _TOOL else "base"

        def send(session: Jogging | Tracking) -> None:
            if isinstance(session, Jogging):
                session.twist(vectors[0], vectors[1], frame=frame, group=self._panels.group)

        self._jogger.ask(client, "jog", send, **hold)

    def _joint(self, client: ClientHandle | None, joint: str, sign: int) -> None:
        joints = self._panels.description.descriptor.joints
        speeds = [sign * self._scale.value * JOINT if each == joint else 0.0 for each in joints]

        def send(session: Jogging | Tracking) -> None:
            if isinstance(session, Jogging):
                session.joint_speed(speeds)

        self._jogger.ask(client, "jog", send)

    def _dragged(self, pose: SE3, client: ClientHandle | None) -> None:
        if not self._lead.value:
            return
        target = pose_of(message_of(pose))

        def send(session: Jogging | Tracking) -> None:
            if isinstance(session, Tracking):
                session.to(target, group=self._panels.group)

        self._jogger.ask(client, "track", send, hold=KEY_HOLD)
