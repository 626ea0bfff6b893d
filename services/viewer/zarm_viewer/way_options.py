"""How the tip gets to the goal: the quickest way, straight lines or arcs, with which freedom, and how fast."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal, NamedTuple

from zarm.motions import Arc, Line, Move, Path, PoseGoal, Waypoints
from zarm.motions import Goal as Target
from zarm.values import Pose
from zarm_contract.errors import InvalidRequest
from zarm_viewer.panel_context import PanelContext

QUICKEST, STRAIGHT, MIDDLE = "quickest", "straight line", "middle of an arc"
"""The ways to a pose; the last is no end of a way: the arc to the next pose leads through it."""
Turn = Literal["theta_x", "theta_y", "theta_z"]
_FREE: dict[str, tuple[Turn, ...]] = {
    "nothing": (),
    "turn about the tool": ("theta_z",),
    "any turn": ("theta_x", "theta_y", "theta_z"),
}
_WAY = "How the tip goes to the goal from the robot or the last waypoint; each waypoint has its own way"
_FREEDOM = "What of the goal's orientation may have any value"
_BLEND = "How far from a waypoint the robot may leave for the next pose, without stopping"


class Passed(NamedTuple):
    """A pose that is passed, and the way to it."""

    pose: Pose
    way: str


@dataclass(frozen=True)
class Way:
    """The way `to_goal`; what of the orientation is `free`; the tool's `speed` (m/s); the `blend` (m) between ways."""

    to_goal: str
    free: tuple[Turn, ...]
    speed: float
    blend: float

    def target(self, through: Sequence[Passed], pose: Pose) -> Target | None:
        """The goal: a pose, reached through others; None where they are reached in different ways."""
        free, poses = self.free, [one.pose for one in through]
        ways = {*(one.way for one in through), self.to_goal}
        if ways == {QUICKEST}:
            goals = [PoseGoal(each, free=free) if free else each for each in (*poses, pose)]
            return Waypoints(*goals) if poses else goals[-1]
        if ways == {STRAIGHT}:
            speed = self.speed
            return Path(*poses, pose, speed=speed, free=free) if poses else Line(pose, speed=speed, free=free)
        return None

    def segments(self, through: Sequence[Passed], pose: Pose, group: str | None) -> list[Move]:
        """The same as a program of a group, whose segments blend where they can."""
        goals = [*self._goals([*through, Passed(pose, self.to_goal)])]
        blends = [
            self.blend if isinstance(one, Line | Arc) == isinstance(other, Line | Arc) else 0.0
            for one, other in pairwise(goals)
        ]
        return [Move(goal, blend=blend, group=group) for goal, blend in zip(goals, (*blends, 0.0), strict=True)]

    def _goals(self, poses: Sequence[Passed]) -> Iterator[Pose | PoseGoal | Line | Arc]:
        free, speed, via = self.free, self.speed, None
        for one in poses:
            if one.way == MIDDLE and via is not None:
                raise InvalidRequest("an arc has one middle; make one of two waypoints in a row the end of a way")
            if one.way == MIDDLE:
                via = one.pose.position
            elif via is not None:
                yield Arc(one.pose, via=via, speed=speed, free=free)
                via = None
            elif one.way == STRAIGHT:
                yield Line(one.pose, speed=speed, free=free)
            else:
                yield PoseGoal(one.pose, free=free) if free else one.pose


class WayOptions:
    """Inputs for the way of the tip."""

    def __init__(self, panels: PanelContext) -> None:
        gui, tool = panels.server.gui, panels.description.descriptor.tool
        self._way = gui.add_dropdown("way", (QUICKEST, STRAIGHT), hint=_WAY)
        self._free = gui.add_dropdown("free", tuple(_FREE), hint=_FREEDOM)
        self._speed = gui.add_number("tool speed (m/s)", tool.speed, min=0.001, max=5.0, step=0.01)
        self._blend = gui.add_number("blend (m)", 0.02, min=0.0, max=0.1, step=0.005, hint=_BLEND)

    @property
    def in_use(self) -> bool:
        """Whether the pose of the tip is the goal, rather than the joints that are shown."""
        return self.chosen.to_goal == STRAIGHT or bool(self.chosen.free)

    @property
    def chosen(self) -> Way:
        """What is chosen now."""
        return Way(self._way.value, _FREE[self._free.value], self._speed.value, self._blend.value)
