"""The planning problem: start, targets and path constraint."""

from __future__ import annotations

import itertools
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from zarm_contract.errors import PlanningFailed
from zarm_contract.messages import CartesianGoal, Goal, GroupsGoal, JointGoal, PoseGoal, WaypointsGoal
from zarm_planner.cartesian.task import ToolTask
from zarm_planner.constraints.path_constraint import ConstraintManifold, constrains
from zarm_planner.context import PlanningContext
from zarm_planner.goals.ends import End, check_start, goal_ends, start_end
from zarm_planner.goals.group_ends import group_ends
from zarm_planner.goals.moving_start import moving_start
from zarm_planner.timing.lead_in import LeadIn
from zarm_trajectory.arrays import Array


@dataclass(frozen=True)
class PlanningProblem:
    """A start and the targets in order, the last of which is the goal; each can be reached in one or several ways.

    `goal` is the requested one. `constraint`, if any, is kept from the start on. If the robot is in motion, `lead_in`
    is how it may brake, and `start` is where it then comes to rest. For a goal along a curve there is a `tool_task` in
    place of targets.
    """

    start: End
    targets: tuple[tuple[End, ...], ...]
    goal: Goal
    constraint: ConstraintManifold | None
    lead_in: LeadIn | None = None
    tool_task: ToolTask | None = None

    @classmethod
    def of(cls, context: PlanningContext, start: Array, goal: Goal, motion: Array | None = None) -> PlanningProblem:
        """The problem of getting from `start` (dof,) to the goal; the ends of each target are sorted by distance from
        the one before.

        `motion` (2, dof) are velocity and acceleration at the start, or None at rest. Raises PlanningFailed
        (`start_in_collision`, `goal_in_collision`, `unreachable`, `no_path` if no braking is free), InvalidRequest for
        a goal that breaks the constraint, and the deadline's error.
        """
        model, constraint = context.model, None
        if isinstance(goal, CartesianGoal):
            check_start(context, start)
            return cls(End.at(start), (), goal, None, tool_task=ToolTask.of(model, goal, start))
        if constrains(context.path_constraint):
            constraint = ConstraintManifold.of(model, context.path_constraint, start)
        lead_in: LeadIn | None = None
        if motion is None or not motion.any():
            begin = start_end(context, start, constraint)
        else:
            vias = isinstance(goal, WaypointsGoal) and len(goal.through) > 1
            lead_in, begin = moving_start(context, np.vstack((start, motion)), vias=vias)
            start = begin.asked
        if isinstance(goal, GroupsGoal):
            return cls(begin, (group_ends(context, start, goal, "goal", constraint),), goal, constraint, lead_in)
        through: dict[str, PoseGoal | JointGoal]
        if isinstance(goal, WaypointsGoal):
            through = {f"goal.through.{number}": waypoint for number, waypoint in enumerate(goal.through)}
        else:
            through = {"goal": goal}
        targets: list[tuple[End, ...]] = []
        for field, target in through.items():
            targets.append(goal_ends(context, start, target, field, constraint))
            start = targets[-1][0].asked
        return cls(begin, tuple(targets), goal, constraint, lead_in)

    def with_thorough_ik(self, context: PlanningContext) -> PlanningProblem:
        """The same problem with all solutions for poses that are free in exact geometry, and no others, and with the long
        ways round of continuous joints; raises as `of` does.

        Spheres may miss a collision: of pairs of links that the descriptor leaves to the exact check, or where they do
        not contain a link. And there may be no path to those few solutions that are considered at first where there is
        little room.
        """
        if all(end.pose is None for ends in self.targets for end in ends) and not context.model.continuous.any():
            return self
        start, motion = self.beginning
        return self.of(replace(context, thorough_ik=True), start, self.goal, motion)

    def with_other_ways(self, context: PlanningContext) -> PlanningProblem:
        """The same problem with the ends of constrained groups and the ways out of tight ends that the context's seed
        gives, after `with_thorough_ik`; this one if there are neither, or no such ways.

        A search gets nowhere from the end of a way that leads into a pocket, or to ends in another part of the
        constraint's manifold.
        """
        together = self.constraint is not None and isinstance(self.goal, GroupsGoal)
        if not together and all(len(end.way) == 0 for end in itertools.chain((self.start,), *self.targets)):
            return self
        start, motion = self.beginning
        with suppress(PlanningFailed):
            return self.of(replace(context, thorough_ik=True), start, self.goal, motion)
        return self

    @property
    def beginning(self) -> tuple[Array, Array | None]:
        """The requested start (dof,), and its velocity and acceleration (2, dof), or None at rest."""
        if self.lead_in is None:
            return self.start.asked, None
        return self.lead_in.state[0], self.lead_in.state[1:]

    @property
    def goals(self) -> Array:
        """The configurations (n, dof) in which a trajectory may end."""
        return np.array([end.asked for end in self.targets[-1]])
