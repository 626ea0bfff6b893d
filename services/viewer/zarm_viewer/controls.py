"""Buttons and inputs of the panels: what happens on use, and values set by the page itself."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from viser import GuiButtonHandle, GuiEvent, IconName

from zarm_viewer.panel_context import PanelContext
from zarm_viewer.style import MOVES


def button(
    panels: PanelContext, label: str, icon: IconName, work: Callable[[], object], *, moves: bool = False
) -> GuiButtonHandle:
    """A button that does `work`, and is disabled until that ends; a different colour if it `moves` the robot. Errors
    are shown on the page that used it.
    """
    handle = panels.server.gui.add_button(label, icon=icon, color=MOVES if moves else None)

    @handle.on_click
    def _(event: GuiEvent[GuiButtonHandle]) -> None:
        handle.disabled = True
        try:
            panels.attempt(label, work, event.client)
        finally:
            handle.disabled = False

    return handle


def changed(panels: PanelContext, handle: Any, label: str, work: Callable[[], object]) -> None:
    """Do `work` whenever a user changes this input, but not when the page does."""

    def update(event: GuiEvent[Any]) -> None:
        if event.client is not None:
            panels.attempt(label, work, event.client)

    handle.on_update(update)


def put(handle: Any, value: object, name: str = "value") -> None:
    """Set a value if it differs."""
    if getattr(handle, name) != value:
        setattr(handle, name, value)
