"""The gripper panel: open, close, or move each gripper to an opening."""

from __future__ import annotations

from functools import partial

from viser import GuiMarkdownHandle, Icon

from zarm_contract.gripper import Gripper
from zarm_contract.messages import GripperState
from zarm_viewer.controls import button
from zarm_viewer.panel_context import PanelContext

_STEP = 0.001


class GripperPanel:
    """The grippers of a robot that has any."""

    def __init__(self, panels: PanelContext) -> None:
        self._panels = panels
        self._states = {
            name: self._add(name, gripper) for name, gripper in panels.description.descriptor.grippers.items()
        }

    def draw(self, states: tuple[GripperState, ...]) -> None:
        """Show how far each is open."""
        for state in states:
            if state.gripper in self._states:
                width = "unknown" if state.width is None else f"{1e3 * state.width:.1f} mm"
                reason = "" if state.problem is None else f": {state.problem.message}"
                self._states[state.gripper].content = f"**{state.gripper}** {width}, {state.status}{reason}"

    def _add(self, name: str, gripper: Gripper) -> GuiMarkdownHandle:
        gui, client = self._panels.server.gui, self._panels.robot.gripper
        shown = gui.add_markdown(f"**{name}**")
        width = gui.add_slider(f"{name} opening (m)", gripper.closed, gripper.open, _STEP, gripper.open)
        button(
            self._panels, f"Open {name}", Icon.ARROWS_HORIZONTAL, partial(client.open, name, preempt=True), moves=True
        )
        button(
            self._panels, f"Close {name}", Icon.ARROWS_MINIMIZE, partial(client.close, name, preempt=True), moves=True
        )
        button(
            self._panels,
            f"Move {name}",
            Icon.ARROW_RIGHT,
            lambda: client.move(width.value, name, preempt=True),
            moves=True,
        )
        return shown
