"""One revision of the scene, made ready for planning."""

from __future__ import annotations

from dataclasses import dataclass

from zarm_contract.messages import SceneRevision
from zarm_geometry.exact import ExactScene
from zarm_geometry.robot_model import RobotModel
from zarm_geometry.world import World


@dataclass(frozen=True)
class PlanningScene:
    """The robot with its attached objects, the obstacles with their margin, and exact geometry of both. Immutable."""

    revision: SceneRevision
    model: RobotModel
    world: World
    exact: ExactScene
