"""Optional views of a robot: collision spheres, clearance, axes, distance to the limits."""

from __future__ import annotations

import threading

import numpy as np

from zarm_contract.errors import ZarmError
from zarm_contract.messages import CheckResult
from zarm_viewer.controls import put
from zarm_viewer.panel_context import PanelContext
from zarm_viewer.picture import Picture

PERIOD = 0.2
"""Interval (s) of the requests for the clearance."""
LIMIT_DISTANCE = np.radians(10.0)
"""A joint this close to a limit (rad) is shown in bold."""


class LooksPanel:
    """Check boxes, and what they show."""

    def __init__(self, panels: PanelContext, picture: Picture) -> None:
        self._panels, self._picture = panels, picture
        gui = panels.server.gui
        spheres = gui.add_checkbox("collision spheres", False)
        spheres.on_update(lambda _: picture.arm.show_spheres(spheres.value))
        axes = gui.add_checkbox("axes of the links", False)
        axes.on_update(lambda _: picture.arm.show_axes(axes.value))
        self._asks = threading.Event()
        self._found: CheckResult | ZarmError | None = None
        if panels.client is not None:
            clearance = gui.add_checkbox("clearance", False, hint="A line between the two nearest points")
            clearance.on_update(lambda _: self._asks.set() if clearance.value else self._asks.clear())
            threading.Thread(target=self._ask, name="clearance", daemon=True).start()
        self._limits = gui.add_checkbox("room to the limits", False)
        self._text = gui.add_markdown("", visible=False)

    def draw(self) -> None:
        """Show what has changed."""
        lines = []
        found = self._found if self._asks.is_set() else None
        if isinstance(found, CheckResult):
            pair = f": {' and '.join(found.pair)}" if found.pair else ""
            lines.append(f"clearance **{found.clearance * 1e3:.0f} mm**{pair}")
        elif found is not None:
            lines.append(str(found))
        self._picture.show_clearance(found.points if isinstance(found, CheckResult) else None)
        if self._limits.value:
            robot = self._panels.description
            for joint, at, low, high in zip(
                robot.descriptor.joints, self._panels.joints, robot.lower, robot.upper, strict=True
            ):
                if np.isinf(low):
                    continue
                distances = f"{np.degrees(at - low):.0f}° down, {np.degrees(high - at):.0f}° up"
                lines.append(
                    f"{joint}: " + (f"**{distances}**" if min(at - low, high - at) < LIMIT_DISTANCE else distances)
                )
        put(self._text, "  \n".join(lines), "content")
        put(self._text, bool(lines), "visible")

    def _ask(self) -> None:
        pause = threading.Event()
        while self._asks.wait():
            try:
                self._found = self._panels.robot.check(points=True, timeout=1.0)[0]
            except ZarmError as error:
                self._found = error
            pause.wait(PERIOD)
