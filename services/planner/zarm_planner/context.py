"""The context of a request through all stages of planning."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

from zarm_contract.messages import PathConstraint
from zarm_geometry.exact import ExactScene
from zarm_geometry.robot_model import RobotModel
from zarm_geometry.world import World
from zarm_planner.deadline import Deadline
from zarm_planner.scene.planning_scene import PlanningScene
from zarm_planner.stage_timer import StageTimer
from zarm_trajectory.limits import Limits


@dataclass(frozen=True)
class PlanningContext:
    """The scene and the options of one request.

    A search gives up after `max_attempts`, each with the next `seed`, or at the `deadline`. For `optimize_s` (s) after
    the first trajectory, it looks for faster ones. `timer` records the time of each stage.

    `assumptions` are checks in exact geometry, in the order of the request, of ends that are free in spheres. A
    verified trajectory proves them; without one, `check_assumptions` tells what is wrong with an end. With
    `thorough_ik`, IK solutions are checked in exact geometry too, before a path is searched to them, and all of those
    with little room are considered.
    """

    scene: PlanningScene
    limits: Limits
    deadline: Deadline
    path_constraint: PathConstraint | None = None
    max_attempts: int = 100
    optimize_s: float = 0.0
    seed: int = 0
    timer: StageTimer = field(default_factory=StageTimer)
    thorough_ik: bool = False
    assumptions: list[Callable[[], None]] = field(default_factory=list)

    @property
    def model(self) -> RobotModel:
        """The robot with what it carries in the scene."""
        return self.scene.model

    @property
    def world(self) -> World:
        """The obstacles, with the margin kept to them."""
        return self.scene.world

    @property
    def exact(self) -> ExactScene:
        """Exact geometry of the robot and the obstacles."""
        return self.scene.exact

    @property
    def dt(self) -> float:
        """The sample period (s) of trajectories."""
        return self.model.robot.descriptor.interpolation_dt

    def check_assumptions(self) -> None:
        """Raises the error of the first end that is in collision although its spheres are free; later calls do nothing."""
        assumptions = self.assumptions.copy()
        self.assumptions.clear()
        for check in assumptions:
            check()

    def with_seed(self, seed: int) -> PlanningContext:
        """The same context with another seed."""
        return self if seed == self.seed else replace(self, seed=seed)

    def for_optimization(self) -> PlanningContext:
        """The same context for the next `optimize_s`; the stages of what is tried then are not timed individually."""
        return replace(self, deadline=self.deadline.sooner(self.optimize_s), timer=StageTimer())
