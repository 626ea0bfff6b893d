"""How the tip gets to the goal: the quickest way or straight lines, with which freedom, and how fast."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

from zarm.motions import Goal as Target
from zarm.motions import Line, Path, PoseGoal, Waypoints
from zarm.values import Pose
from zarm_viewer.panel_context import PanelContext

_QUICKEST, _STRAIGHT = "quickest", "straight lines"
Turn = Literal["theta_x", "theta_y", "theta_z"]
_FREE: dict[str, tuple[Turn, ...]] = {
    "nothing": (),
    "turn about the tool": ("theta_z",),
    "any turn": ("theta_x", "theta_y", "theta_z"),
}
_WAY = "straight lines: the tip goes through the waypoints to the goal, with rounded corners and the speed below"
_FREEDOM = "What of the goal's orientation may have any value"


class WayOptions:
    """Inputs for the way of the tip."""

    def __init__(self, panels: PanelContext) -> None:
        gui, tool = panels.server.gui, panels.description.descriptor.tool
        self._way = gui.add_dropdown("way", (_QUICKEST, _STRAIGHT), hint=_WAY)
        self._free = gui.add_dropdown("free", tuple(_FREE), hint=_FREEDOM)
        self._speed = gui.add_number("tool speed (m/s)", tool.speed, min=0.001, max=5.0, step=0.01)

    @property
    def in_use(self) -> bool:
        """Whether the pose of the tip is the goal, rather than the joints that are shown."""
        return self._way.value == _STRAIGHT or bool(_FREE[self._free.value])

    def target(self, through: Sequence[Pose], pose: Pose) -> Target:
        """The goal: a pose, reached through others."""
        free = _FREE[self._free.value]
        if self._way.value == _STRAIGHT and through:
            return Path(*through, pose, speed=self._speed.value, free=free)
        if self._way.value == _STRAIGHT:
            return Line(pose, speed=self._speed.value, free=free)
        goals = [PoseGoal(each, free=free) if free else each for each in (*through, pose)]
        return Waypoints(*goals) if through else goals[-1]
