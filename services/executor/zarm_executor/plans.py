"""The plans that can be executed."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass

from zarm_contract.errors import ExecutionRefused, InvalidRequest, Unavailable
from zarm_contract.messages import (
    ExecuteRequest,
    Openings,
    PathConstraint,
    Plan,
    PlannedSegment,
    Pose,
    SceneRevision,
    Touch,
    Trajectory,
)

PLANS_KEPT = 32
"""Number of plans that remain executable by id."""

PUBLICATION_PATIENCE = 0.5
"""Longest wait (s) for the publication of a plan whose id a client already knows."""


@dataclass(frozen=True)
class Chosen:
    """The plan to execute, or a trajectory without a plan, which need not claim a scene.

    `tip` is the goal of the plan, if that is a pose, and `path_constraint` what it keeps to. `segments` are the times (s) at which the segments of a program
    begin, `touches` where objects may be touched, `openings` those of the grippers, and `acts` the segments at which
    they move or outputs are switched. A plan `along_curve`, on which the tip keeps to lines, arcs or the ways of a program, must not be
    replanned.
    """

    plan_id: str | None
    trajectory: Trajectory
    scene_revision: SceneRevision | None
    tip: Pose | None = None
    segments: tuple[float, ...] = ()
    along_curve: bool = False
    touches: tuple[Touch, ...] = ()
    openings: Openings = ()
    acts: tuple[PlannedSegment, ...] = ()
    path_constraint: PathConstraint | None = None

    @property
    def name(self) -> str:
        """Its name in a refusal."""
        return self.plan_id or "the trajectory"


class Plans:
    """The planner's latest plans. Thread-safe.

    A client may request execution of a plan before its publication is received here. In that case `newest` asks the
    planner for its newest plan; it raises Unavailable if none answers.
    """

    def __init__(self, robot_hash: str, newest: Callable[[], Plan]) -> None:
        self._robot_hash = robot_hash
        self._newest = newest
        self._plans: OrderedDict[str, Plan] = OrderedDict()
        self._changed = threading.Condition()

    def add(self, _key: str, plan: Plan) -> None:
        """Remember a plan."""
        with self._changed:
            self._plans[plan.plan_id] = plan
            self._plans.move_to_end(plan.plan_id)
            if len(self._plans) > PLANS_KEPT:
                self._plans.popitem(last=False)
            self._changed.notify_all()

    def chosen(self, request: ExecuteRequest) -> Chosen:
        """The plan or trajectory that a request names.

        Raises InvalidRequest for an unknown plan, ExecutionRefused (`stale_plan`) for one of another robot.
        """
        if request.trajectory is not None:
            return Chosen(None, request.trajectory, request.scene_revision, openings=request.openings)
        plan = self._last() if request.plan_id is None else self._named(request.plan_id)
        if plan.robot_hash != self._robot_hash:
            raise ExecutionRefused(
                f"{plan.plan_id} was made for another description of this robot (hash {plan.robot_hash}, here "
                f"{self._robot_hash}); start the planner with the same descriptor and plan again",
                code="stale_plan",
            )
        tip = None if plan.selected_goal_index is None else plan.tip
        segments = tuple(segment.begin for segment in plan.segments)
        along_curve = plan.tool is not None or bool(segments)
        return Chosen(
            plan.plan_id,
            plan.trajectory,
            plan.scene_revision,
            tip,
            segments,
            along_curve,
            plan.touches,
            plan.openings,
            tuple(segment for segment in plan.segments if segment.grip is not None or segment.output is not None),
            plan.path_constraint,
        )

    def _last(self) -> Plan:
        newest = self._ask()
        if newest is not None:
            return newest
        with self._changed:
            if not self._plans:
                raise InvalidRequest("there is no plan to execute yet; plan first (planner/plan), or send a trajectory")
            return next(reversed(self._plans.values()))

    def _named(self, plan_id: str) -> Plan:
        with self._changed:
            plan = self._plans.get(plan_id)
        if plan is not None:
            return plan
        newest = self._ask()
        if newest is not None and newest.plan_id == plan_id:
            return newest
        with self._changed:  # an older plan may still be on its way
            self._changed.wait_for(lambda: plan_id in self._plans, PUBLICATION_PATIENCE)
            plan = self._plans.get(plan_id)
        if plan is None:
            raise InvalidRequest(
                f"the plan {plan_id} is not among the last {PLANS_KEPT}; plan again and use the new plan_id",
                field="plan_id",
            )
        return plan

    def _ask(self) -> Plan | None:
        try:
            return self._newest()
        except Unavailable:
            return None
