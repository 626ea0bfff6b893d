"""Motion plan requests of MoveIt, planned by zarm."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from copy import copy
from dataclasses import dataclass
from typing import Any

import numpy as np
from moveit_msgs.msg import MoveItErrorCodes as Val

from zarm_contract.errors import PlanningFailed, ZarmError
from zarm_contract.messages import (
    Goal,
    GroupsGoal,
    IkRequest,
    Joints,
    Move,
    Plan,
    PlanRequest,
    PoseGoal,
    ProgramRequest,
    SpeedChange,
)
from zarm_ros_bridge.convert.fields import finite, in_terms_of
from zarm_ros_bridge.engine import Engine
from zarm_ros_bridge.frames import Frames
from zarm_ros_bridge.moveit.arm_groups import ArmGroup, ArmGroups
from zarm_ros_bridge.moveit.constraint_set import ConstraintSet
from zarm_ros_bridge.moveit.curves import Curves, Speeds
from zarm_ros_bridge.moveit.error_codes import Refusal
from zarm_ros_bridge.moveit.goals import goals_of, tips_goal
from zarm_ros_bridge.moveit.path_constraints import constrained_plan, kept
from zarm_ros_bridge.moveit.planners import along
from zarm_ros_bridge.moveit.states import Positions, start_of

MAX_PLANNING_TIME = 60.0
"""The longest planning time (s)."""
_SLOWER = 0.95
"""Factor by which a motion that is too fast for a bound of a link's speed is slowed below that bound."""
_SLOWEST = 0.01
_ROUNDS = 4
_SOLUTIONS = 64
"""Configurations that reach a pose, among which bounds of joints choose."""
_FIELDS = {"goal": "goal_constraints", "start": "start_state", "path_constraint": "path_constraints"}
"""Fields of a plan request, and their names in a motion plan request."""

Ask = Callable[[PlanRequest | ProgramRequest], Plan]
"""Asks the planner."""


@dataclass(frozen=True)
class Scales:
    """Shares of the limits of velocity and acceleration (0..1]."""

    velocity: float
    acceleration: float

    @classmethod
    def of(cls, request: Any) -> Scales:
        """Those of a request: 0 means 1, and more than 1 means 1, as in MoveIt. Raises Refusal for a negative one."""
        values = []
        for name in ("max_velocity_scaling_factor", "max_acceleration_scaling_factor"):
            value = finite(getattr(request, name), name)
            if value < 0.0:
                raise Refusal(Val.INVALID_MOTION_PLAN, f"{value:g} is negative; give a share from 0 to 1", name)
            values.append(min(value, 1.0) or 1.0)
        return cls(*values)


class MotionPlanRequests:
    """Plans what clients of MoveIt request. Thread-safe."""

    def __init__(self, engine: Engine, frames: Frames, groups: ArmGroups) -> None:
        self._engine = engine
        self._frames = frames
        self._curves = Curves(engine, frames)
        self.groups = groups

    def plan(self, request: Any, ask: Ask) -> Plan:
        """The plan for a `MotionPlanRequest`. Raises Refusal, and the planner's errors with the fields of the request."""
        try:
            return self._plan(request, ask)
        except Refusal:
            raise
        except ZarmError as error:
            raise in_terms_of(error, _FIELDS) from error

    def _plan(self, request: Any, ask: Ask) -> Plan:
        group = self.check(request)
        start = start_of(request.start_state, self._frames, self._engine.joints, "start_state")
        scales = Scales.of(request)
        options: dict[str, Any] = {
            "group": group.name,
            "start": start,
            "timeout": min(request.allowed_planning_time, MAX_PLANNING_TIME)
            if request.allowed_planning_time > 0.0
            else None,
            "velocity_scale": scales.velocity,
            "acceleration_scale": scales.acceleration,
        }
        curve = along(request.pipeline_id, request.planner_id)
        begin = start or self._frames.joints()
        if curve is not None:
            goal = self._curves.goal(curve, request, begin, self._speeds(request, scales), group)
            return self._followed(curve, request, begin, ask(PlanRequest(goal=goal, **options)))
        constraints = self._along_way(None, request)
        return self._first(
            self._goals(request, begin, group),
            lambda goal: self._kept(
                PlanRequest(goal=goal, **options | {"group": _named(group, goal)}),
                request,
                constraints,
                begin,
                group,
                ask,
            ),
        )

    def plan_sequence(self, items: Sequence[Any], ask: Ask) -> Plan:
        """One motion through the goals of `MotionSequenceItem`s. Raises Refusal, and the planner's errors."""
        if not items:
            raise Refusal(Val.INVALID_MOTION_PLAN, "the sequence has no items", "items")
        segments: list[Move | SpeedChange] = []
        first = items[0].req
        start = start_of(first.start_state, self._frames, self._engine.joints, "items[0].req.start_state")
        begin = start or self._frames.joints()
        timeout, scales = 0.0, None
        for i, item in enumerate(items):
            try:
                move, own = self._segment(i, items, begin)
            except ZarmError as error:
                raise _placed(error, f"items[{i}].req") from error
            if own != scales:
                scales = own
                segments.append(
                    SpeedChange(kind="speed", velocity_scale=own.velocity, acceleration_scale=own.acceleration)
                )
            segments.append(move)
            timeout += item.req.allowed_planning_time
        return ask(
            ProgramRequest(
                segments=tuple(segments),
                start=start,
                timeout=min(timeout, MAX_PLANNING_TIME) if timeout > 0.0 else None,
            )
        )

    def check(self, request: Any) -> ArmGroup:
        """The group of a request. Raises Refusal for one that the robot has not, and for what zarm has no meaning for."""
        group = self.groups.of(request.group_name)
        if request.trajectory_constraints.constraints:
            raise Refusal(
                Val.INVALID_MOTION_PLAN,
                "trajectory constraints have no meaning for any planner of zarm; give path constraints",
                "trajectory_constraints",
            )
        return group

    def _segment(self, i: int, items: Sequence[Any], begin: Positions) -> tuple[Move, Scales]:
        request = items[i].req
        group = self.check(request)
        if i and (request.start_state.joint_state.name or request.start_state.multi_dof_joint_state.joint_names):
            raise Refusal(Val.INVALID_ROBOT_STATE, "only the first item has a start state; leave it out", "start_state")
        radius = finite(items[i].blend_radius, "blend_radius")
        if radius < 0.0 or (radius and i == len(items) - 1):
            raise Refusal(
                Val.INVALID_MOTION_PLAN, "a blend radius is not negative, and 0 for the last item", "blend_radius"
            )
        scales = Scales.of(request)
        curve = along(request.pipeline_id, request.planner_id)
        if self._along_way(curve, request):
            raise Refusal(Val.INVALID_MOTION_PLAN, "path constraints are not kept in a sequence", "path_constraints")
        if curve is not None:
            goal: Goal = self._curves.goal(curve, request, begin, self._speeds(request, scales), group)
        else:
            goals = self._goals(request, begin, group)
            if len(goals) > 1:
                raise Refusal(
                    Val.INVALID_GOAL_CONSTRAINTS,
                    "alternatives in a sequence are poses of one link with the same tolerance",
                    "goal_constraints",
                )
            (goal,) = goals
        blend = radius if self._blends(i, items) else 0.0
        return Move(kind="move", goal=goal, group=_named(group, goal), blend=blend), scales

    def _along_way(self, curve: str | None, request: Any) -> ConstraintSet:
        """The path constraints of a request; positions for CIRC and POLYLINE are points of the curve, and none."""
        constraints = copy(request.path_constraints)
        if curve in ("CIRC", "POLYLINE"):
            constraints.position_constraints = []
        return ConstraintSet(constraints, self._engine, self._frames, "path_constraints")

    def _followed(self, curve: str, request: Any, begin: Positions, plan: Plan) -> Plan:
        """The plan along a curve, if it keeps the path constraints. Raises Refusal, or PlanningFailed."""
        constraints = self._along_way(curve, request)
        if not constraints or kept(plan, constraints):
            return plan
        if not constraints.holds(begin):
            raise Refusal(
                Val.START_STATE_VIOLATES_PATH_CONSTRAINTS,
                "the start is outside the path constraints; move the robot inside first, or widen them",
                "path_constraints",
            )
        raise PlanningFailed("the curve leaves the path constraints; widen them", field="path_constraints")

    def _blends(self, i: int, items: Sequence[Any]) -> bool:
        """Whether an item is blended into the next: both are lines or arcs, moved along in the same way."""
        if i + 1 >= len(items):
            return False
        one, other = items[i].req, items[i + 1].req
        curves = all(along(item.pipeline_id, item.planner_id) in ("LIN", "CIRC") for item in (one, other))
        same = (
            "group_name",
            "max_velocity_scaling_factor",
            "max_acceleration_scaling_factor",
            "max_cartesian_speed",
            "cartesian_speed_limited_link",
        )
        return curves and all(getattr(one, name, None) == getattr(other, name, None) for name in same)

    def _goals(self, request: Any, begin: Positions, group: ArmGroup) -> list[Goal]:
        if not request.goal_constraints:
            raise Refusal(Val.INVALID_GOAL_CONSTRAINTS, "there is no goal; give one", "goal_constraints")
        sets = [
            ConstraintSet(one, self._engine, self._frames, f"goal_constraints[{i}]")
            for i, one in enumerate(request.goal_constraints)
        ]
        robot = group.robot
        if group.arms and any(one.links for one in sets):
            now = self._frames.links.poses(begin)
            return [tips_goal(one, group.arms, now.__getitem__, f"goal_constraints[{i}]") for i, one in enumerate(sets)]
        tip = lambda: self._frames.links.poses(begin)[robot.descriptor.tip_link]  # noqa: E731  goals of joints need none

        def ik(goal: PoseGoal, wanted: Mapping[str, float]) -> list[Joints]:
            near = tuple(wanted.get(name, at) for name, at in zip(self._engine.joints, begin, strict=True))
            asked = IkRequest(
                poses=goal.poses,
                tolerance=goal.tolerance,
                tip=goal.tip,
                group=group.name,
                near=near,
                max_solutions=_SOLUTIONS,
            )
            return [one for each in self._engine.client.request_ik(asked).solutions for one in each]

        return goals_of(sets, group.part(begin), robot, tip, ik)

    def _speeds(self, request: Any, scales: Scales) -> Speeds:
        most = finite(request.max_cartesian_speed, "max_cartesian_speed")
        return Speeds.of(self._engine.robot.descriptor.tool, scales.velocity, scales.acceleration, most)

    def _first(self, goals: Sequence[Goal], plan: Callable[[Goal], Plan]) -> Plan:
        """The plan to the first goal that has one; the first error if none has."""
        fault: ZarmError | None = None
        for goal in goals:
            try:
                return plan(goal)
            except PlanningFailed as error:
                fault = fault or error
        raise fault or AssertionError

    def _kept(
        self,
        asked: PlanRequest,
        request: Any,
        constraints: ConstraintSet,
        begin: Positions,
        group: ArmGroup,
        ask: Ask,
    ) -> Plan:
        """The plan that keeps path constraints and the bound of a link's speed."""

        def plan(wanted: PlanRequest) -> Plan:
            if not constraints:
                return ask(wanted)
            if isinstance(wanted.goal, GroupsGoal):
                raise Refusal(
                    Val.INVALID_MOTION_PLAN,
                    "path constraints are kept by one tip; plan for its group",
                    "path_constraints",
                )
            return constrained_plan(
                wanted, constraints, begin, group.robot.descriptor.tip_link, self._frames.links, ask
            )

        most = finite(request.max_cartesian_speed, "max_cartesian_speed")
        made = plan(asked)
        for _ in range(_ROUNDS if most > 0.0 else 0):
            speed = self._speed(made, request.cartesian_speed_limited_link, group)
            if speed <= most:
                return made
            scale = max((asked.velocity_scale or 1.0) * _SLOWER * most / speed, _SLOWEST)
            asked = asked.model_copy(update={"velocity_scale": scale})
            made = plan(asked)
        if most > 0.0 and self._speed(made, request.cartesian_speed_limited_link, group) > most:
            raise PlanningFailed(
                f"no motion was found in which the link keeps to {most:g} m/s; allow it more",
                field="max_cartesian_speed",
            )
        return made

    def _speed(self, plan: Plan, link: str, group: ArmGroup) -> float:
        """The greatest speed (m/s) of a link between two samples of a plan."""
        name = link or group.robot.descriptor.tip_link
        if name not in self._frames.links.links:
            raise Refusal(Val.INVALID_LINK_NAME, f"the robot has no link {name!r}", "cartesian_speed_limited_link")
        points = np.array([self._frames.links.poses(at)[name][:3, 3] for at in plan.trajectory.position])
        way = np.linalg.norm(np.diff(points, axis=0), axis=1)
        return float(np.max(way / np.diff(plan.trajectory.time)))


def _named(group: ArmGroup, goal: Goal) -> str | None:
    """The group that a request names: a goal of several groups names them itself."""
    return None if isinstance(goal, GroupsGoal) else group.name


def ask(engine: Engine, request: PlanRequest | ProgramRequest) -> Plan:
    """The planner's answer, outside any goal."""
    if isinstance(request, ProgramRequest):
        return engine.client.request_program(request)
    return engine.client.request_plan(request)


def _placed(error: ZarmError, place: str) -> ZarmError:
    """The same error, with the place of its field."""
    problem = error.problem.model_copy(update={"field": f"{place}.{error.problem.field or 'goal_constraints'}"})
    if isinstance(error, Refusal):
        return Refusal(error.val, problem.message, problem.field)
    return type(error)(problem.message, code=problem.code, field=problem.field)
