"""The plans that can be executed, and the scene that they must not be older than."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable

from zarm_contract.errors import ExecutionRefused, InvalidRequest, Unavailable
from zarm_contract.messages import ExecuteRequest, Plan, SceneEdited, Trajectory

REMEMBERED = 32
"""How many plans stay executable by their id."""

PUBLICATION_PATIENCE = 0.5
"""Longest wait, s, for the publication of a plan whose id a client knows already."""


class Plans:
    """The last plans of the planner and the present revision of its scene. Safe from any thread.

    A client may have its plan from the planner, or have edited the scene, and ask for an execution before the publication
    of that is read here. So `newest` asks the planner for its newest plan, and `scene` for the scene's revision; they raise
    Unavailable where none answers.
    """

    def __init__(self, robot_hash: str, newest: Callable[[], Plan], scene: Callable[[], SceneEdited]) -> None:
        self._robot_hash = robot_hash
        self._newest = newest
        self._scene = scene
        self._plans: OrderedDict[str, Plan] = OrderedDict()
        self._revision = 0
        self._changed = threading.Condition()

    def add(self, _key: str, plan: Plan) -> None:
        """Remember a plan."""
        with self._changed:
            self._plans[plan.plan_id] = plan
            self._plans.move_to_end(plan.plan_id)
            if len(self._plans) > REMEMBERED:
                self._plans.popitem(last=False)
            self._changed.notify_all()

    def set_scene(self, _key: str, scene: SceneEdited) -> None:
        """Note the present revision of the scene."""
        with self._changed:
            self._revision = scene.revision

    def chosen(self, request: ExecuteRequest) -> tuple[str | None, Trajectory]:
        """The plan id, if it is a plan, and the trajectory that a request asks for.

        Raises InvalidRequest for a plan that is not known, ExecutionRefused (`stale_plan`) for one that no longer holds.
        """
        if request.trajectory is not None:
            if request.scene_revision is not None:
                self._check_revision("the trajectory", request.scene_revision)
            return None, request.trajectory
        plan = self._last() if request.plan_id is None else self._named(request.plan_id)
        if plan.robot_hash != self._robot_hash:
            raise ExecutionRefused(
                f"{plan.plan_id} was made for another description of this robot (hash {plan.robot_hash}, here "
                f"{self._robot_hash}); start the planner with the same descriptor and plan again",
                code="stale_plan",
            )
        self._check_revision(plan.plan_id, plan.scene_revision)
        return plan.plan_id, plan.trajectory

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
        with self._changed:  # it may be one before the newest
            self._changed.wait_for(lambda: plan_id in self._plans, PUBLICATION_PATIENCE)
            plan = self._plans.get(plan_id)
        if plan is None:
            raise InvalidRequest(
                f"the plan {plan_id} is not among the last {REMEMBERED}; plan again and use the new plan_id",
                field="plan_id",
            )
        return plan

    def _ask(self) -> Plan | None:
        try:
            return self._newest()
        except Unavailable:
            return None

    def _check_revision(self, what: str, revision: int) -> None:
        try:
            present = self._scene().revision
        except Unavailable:
            with self._changed:
                present = self._revision
        if revision < present:
            raise ExecutionRefused(
                f"{what} was verified in revision {revision} of the scene, which is at {present} now; plan again",
                code="stale_plan",
            )
