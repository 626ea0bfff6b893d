"""The plans that can be executed, and the scene that they must not be older than."""

from __future__ import annotations

import threading
from collections import OrderedDict

from pydantic import ConfigDict

from zarm_contract._model import Message
from zarm_contract.errors import ExecutionRefused, InvalidRequest
from zarm_contract.messages import ExecuteRequest, Plan, Trajectory

REMEMBERED = 32
"""How many plans stay executable by their id."""


class SceneRevision(Message):
    """What the executor needs of a `Scene`: reading ten thousand objects would hold up the control loop."""

    model_config = ConfigDict(extra="ignore")

    revision: int


class Plans:
    """The last plans of the planner and the present revision of its scene. Safe from any thread."""

    def __init__(self, robot_hash: str) -> None:
        self._robot_hash = robot_hash
        self._plans: OrderedDict[str, Plan] = OrderedDict()
        self._revision = 0
        self._lock = threading.Lock()

    def add(self, _key: str, plan: Plan) -> None:
        """Remember a plan."""
        with self._lock:
            self._plans[plan.plan_id] = plan
            self._plans.move_to_end(plan.plan_id)
            if len(self._plans) > REMEMBERED:
                self._plans.popitem(last=False)

    def set_scene(self, _key: str, scene: SceneRevision) -> None:
        """Note the present revision of the scene."""
        with self._lock:
            self._revision = scene.revision

    def chosen(self, request: ExecuteRequest) -> tuple[str | None, Trajectory]:
        """The plan id, if it is a plan, and the trajectory that a request asks for.

        Raises InvalidRequest for a plan that is not known, ExecutionRefused (`stale_plan`) for one that no longer holds.
        """
        with self._lock:
            if request.trajectory is not None:
                if request.scene_revision is not None:
                    self._check_revision("the trajectory", request.scene_revision)
                return None, request.trajectory
            plan = self._find(request.plan_id)
            if plan.robot_hash != self._robot_hash:
                raise ExecutionRefused(
                    f"{plan.plan_id} was made for another description of this robot (hash {plan.robot_hash}, here "
                    f"{self._robot_hash}); start the planner with the same descriptor and plan again",
                    code="stale_plan",
                )
            self._check_revision(plan.plan_id, plan.scene_revision)
            return plan.plan_id, plan.trajectory

    def _find(self, plan_id: str | None) -> Plan:
        if plan_id is None:
            if not self._plans:
                raise InvalidRequest("there is no plan to execute yet; plan first (planner/plan), or send a trajectory")
            return next(reversed(self._plans.values()))
        plan = self._plans.get(plan_id)
        if plan is None:
            raise InvalidRequest(
                f"the plan {plan_id} is not among the last {REMEMBERED}; plan again and use the new plan_id",
                field="plan_id",
            )
        return plan

    def _check_revision(self, what: str, revision: int) -> None:
        if revision < self._revision:
            raise ExecutionRefused(
                f"{what} was verified in revision {revision} of the scene, which is at {self._revision} now; plan again",
                code="stale_plan",
            )
