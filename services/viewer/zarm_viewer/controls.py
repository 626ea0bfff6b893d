"""Buttons and inputs of the panels: what happens on use, and values set by the page itself."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from viser import GuiButtonHandle, GuiEvent, IconName

from zarm_viewer.desk import Desk
from zarm_viewer.style import MOVES


def button(
    desk: Desk, label: str, icon: IconName, work: Callable[[], object], *, moves: bool = False
) -> GuiButtonHandle:
    """A button that does `work`, in another colour where that `moves` the robot, and waits for it before it can be used again; what goes wrong is told on that page."""
    handle = desk.server.gui.add_button(label, icon=icon, color=MOVES if moves else None)

    @handle.on_click
    def _(event: GuiEvent[GuiButtonHandle]) -> None:
        handle.disabled = True
        try:
            desk.attempt(label, work, event.client)
        finally:
            handle.disabled = False

    return handle


def changed(desk: Desk, handle: Any, label: str, work: Callable[[], object]) -> None:
    """Do `work` whenever somebody changes this input; not where the page does."""

    def update(event: GuiEvent[Any]) -> None:
        if event.client is not None:
            desk.attempt(label, work, event.client)

    handle.on_update(update)


def put(handle: Any, value: object, name: str = "value") -> None:
    """Show a value, where it is another."""
    if getattr(handle, name) != value:
        setattr(handle, name, value)
