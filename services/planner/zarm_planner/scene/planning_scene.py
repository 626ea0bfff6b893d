"""One scene revision, prepared for planning."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

from zarm_contract.messages import SceneRevision
from zarm_geometry.exact import ExactScene
from zarm_geometry.robot_model import RobotModel
from zarm_geometry.world import World


@dataclass(frozen=True)
class PlanningScene:
    """The robot with its attached objects, the obstacles with their margin, and exact geometry of both. Immutable.

    The search keeps `self_margin` (m) between the robot's links.
    """

    revision: SceneRevision
    model: RobotModel
    world: World
    exact: ExactScene
    self_margin: float = 0.0

    def with_margin(self, margin: float) -> Self:
        """The same scene with another margin (m) to objects."""
        return replace(self, world=self.world.with_margin(margin))

    def with_self_margin(self, margin: float) -> Self:
        """The same scene with another `self_margin` (m)."""
        return replace(self, model=self.exact.model.with_self_margin(margin), self_margin=margin)
