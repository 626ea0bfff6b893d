"""Motions of the tip along a line, an arc or a path, with the speed that is asked for."""

from __future__ import annotations

from collections.abc import Iterator

from zarm_contract.errors import InvalidRequest, PlanningFailed
from zarm_planner.cartesian.curve import ToolCurve
from zarm_planner.cartesian.following import Following
from zarm_planner.cartesian.joint_curve import JointCurve
from zarm_planner.cartesian.task import ToolTask
from zarm_planner.cartesian.timing import time_along
from zarm_planner.context import PlanningContext
from zarm_planner.goals.problem import PlanningProblem
from zarm_planner.planners.base import Planner
from zarm_trajectory.arrays import Array
from zarm_trajectory.trajectory import TimedTrajectory

_NAME = "cartesian"
_REFINEMENTS = 6
"""How often the stations may be doubled."""
_ATTEMPTS = 10
"""Most attempts to find another way to use the freedom."""
_GAIN = 0.02
"""Share of the curve by which twice as many stations have to lead further, or a search among ways to use freedom, which takes
long, is not repeated with more.
"""
_DEVIATION_SHARE = 0.3
"""Share of the permitted deviation that the joints may use between two stations."""


class CartesianPlanner(Planner):
    """Along a curve of the tip."""

    names = {"line": _NAME, "arc": _NAME, "path": _NAME}  # noqa: RUF012

    def trajectories(self, context: PlanningContext, problem: PlanningProblem) -> Iterator[TimedTrajectory]:
        """The motion along the curve, with the columns of its progress; there is no other."""
        if (task := problem.tool_task) is None:
            raise InvalidRequest("there is no curve to follow; ask for a line, an arc or a path", field="goal")
        curve, joints = self._followed(context, task, problem.start.asked)
        with context.timer.stage("timing"):
            trajectory = time_along(curve, joints, context.limits, context.dt)
        if trajectory is not None:
            yield trajectory

    def attempts(self, context: PlanningContext, problem: PlanningProblem) -> int:
        """One where the curve leaves no choice."""
        task = problem.tool_task
        return min(context.max_attempts, _ATTEMPTS) if task is not None and task.has_freedom else 1

    def _followed(self, context: PlanningContext, task: ToolTask, start: Array) -> tuple[ToolCurve, JointCurve]:
        """The curve with as many stations as it takes, and the curve of the joints along it."""
        curve, furthest = task.curve, -1.0
        for number in range(_REFINEMENTS):
            try:
                with context.timer.stage("search"):
                    path = Following(context.scene, context.deadline, context.seed, curve, task, start).path()
                with context.timer.stage("shortcut"):
                    joints = JointCurve.of(curve, path)
                    if task.use_between(joints) <= _DEVIATION_SHARE:
                        return curve, joints
            except PlanningFailed as stopped:  # near a singularity the joints move far between two stations
                fraction = stopped.problem.fraction or 0.0
                if number == _REFINEMENTS - 1 or (task.has_freedom and fraction < furthest + _GAIN):
                    raise
                furthest = fraction
            curve = curve.refined()
        raise PlanningFailed(
            "no smooth motion of the joints follows the curve closely enough; move it away from a singularity",
            code="no_path",
        )
